"""Computes the style of elements: parses their declarations, and applies inheritance."""

import contextlib
import re
from collections.abc import Callable
from typing import Any, NamedTuple

from ..values.css_color import CURRENT, Rgba, color_of
from ..values.numbers import finite, fraction, is_number
from ..values.units import MEDIUM, Viewport
from ..xml.notices import INVALID, WITHOUT_EFFECT, kind_of_refused
from .cascade import Declarations
from .font_size import font_size_of, shorthand_size

_URL = re.compile(r"url\(\s*+(?:\"([^\"]*+)\"|'([^']*+)'|([^()\"'\s]*+))\s*+\)\s*+")

_WORD = re.compile(r"[^\s()]++(?:\([^()]*+\))?+")
"""A word of a value, or a function without functions in it."""

_VECTOR_EFFECTS = (
    "none", "non-scaling-stroke", "non-scaling-size", "non-rotation", "fixed-position", "viewport",
    "screen",
)  # fmt: skip

BLACK: Rgba = (0.0, 0.0, 0.0, 1.0)


class PaintServer(NamedTuple):
    """A paint that refers to a gradient or pattern, as in `url(#id) red`.

    - `reference`: the text between the parentheses, such as `#id`.
    - `fallback`: the paint after the reference, which is used if the reference is broken: a colour,
      `CURRENT`, or None for `none`. False if no fallback is given.
    """

    reference: str
    fallback: Rgba | str | bool | None = False


Paint = Rgba | str | PaintServer | None
"""A colour, `CURRENT` for `currentColor`, a reference, or None for no paint."""


class Style(NamedTuple):
    """Computed style of an element. Fields are named after CSS properties.

    `opacity` and the fields after it are not inherited. Lengths are in user units, and opacities
    are in 0..1.

    - `color`: an `Rgba`. `stop_color` and `background_color` may also be `CURRENT`.
    - `stroke_dasharray`: an even number of lengths; empty for a solid line.
    - `overflow`: empty if it is not declared.
    - `clip_path`: text of the property, such as `url(#id)`; None for `none`.
    - `transform_origin`: text of the property.
    """

    fill: Paint = BLACK
    stroke: Paint = None
    color: Any = BLACK
    fill_opacity: float = 1.0
    stroke_opacity: float = 1.0
    fill_rule: str = "nonzero"
    clip_rule: str = "nonzero"
    stroke_width: float = 1.0
    stroke_linecap: str = "butt"
    stroke_linejoin: str = "miter"
    stroke_miterlimit: float = 4.0
    stroke_dasharray: tuple[float, ...] = ()
    stroke_dashoffset: float = 0.0
    paint_order: tuple[str, ...] = ("fill", "stroke")
    visibility: str = "visible"
    font_size: float = MEDIUM
    opacity: float = 1.0
    display: str = "inline"
    overflow: str = ""
    vector_effect: str = "none"
    clip_path: str | None = None
    transform_origin: str = "0 0"
    transform_box: str = "view-box"
    stop_color: Any = BLACK
    stop_opacity: float = 1.0
    background_color: Any = (0.0, 0.0, 0.0, 0.0)


INITIAL = Style()

_NOT_INHERITED = INITIAL._asdict()
for _name in Style._fields[: Style._fields.index("opacity")]:
    del _NOT_INHERITED[_name]

UNSUPPORTED = {
    # Properties that are not supported, and for each the values that do not change the image.
    "filter": ("none",),
    "marker": ("none",),
    "marker-end": ("none",),
    "marker-mid": ("none",),
    "marker-start": ("none",),
    "mask": ("none",),
    "mix-blend-mode": ("normal",),
}

_UNSUPPORTED_IN_CSS = {
    # Like `UNSUPPORTED`, for properties that are no presentation attributes.
    "animation": ("none",),
    "animation-name": ("none",),
    "backdrop-filter": ("none",),
    "clip": ("auto",),
    "mask-image": ("none",),
    "-webkit-filter": ("none",),
    "-webkit-mask": ("none",),
    "-webkit-mask-image": ("none",),
    "-webkit-transform": ("none",),
    "offset": ("none",),
    "offset-path": ("none",),
    "zoom": ("1", "100%", "normal"),
}

_CSS_ONLY = ("background", "background-color")
"""Properties that are no presentation attributes."""

_WITH_UNITS = ("font-size", "transform-origin")
"""Properties whose lengths need a unit in CSS, unlike lengths of strokes (SVG 2, section 13.5)."""

Note = Callable[[str, str, str], None]
"""Function that notes a fault: the kind of notice, the name of the property, what is wrong."""


def computed(declared: Declarations, parent: Style, viewport: Viewport, note: Note) -> Style:
    """Compute the style of an element from its declarations and the style of its parent.

    - `viewport`: sizes to which lengths and percentages are relative.
    - `note`: called for each invalid declaration, and each property that is not supported.

    An invalid declaration has no effect, as CSS says: the one of the next lower rank counts.
    """
    # Computed first, since other lengths may depend on it. Invalid declarations of it are noted
    # below.
    font_size = _computed_font_size(declared, parent, viewport)
    changes: dict[str, Any] = {"font_size": font_size}
    for source in (declared.attributes, declared.css):
        for name, value in source.items():
            field = _FIELDS.get(name)
            if field is None or (name in _CSS_ONLY and source is declared.attributes):
                if _is_unsupported(name, value, source is declared.css):
                    note(WITHOUT_EFFECT, name, value)
                if name == "font" and source is declared.css:
                    _note_invalid_font(value, parent, viewport, note)
                continue
            if source is declared.attributes and name in declared.css:
                continue
            for declaration in _by_rank(declared, name):
                try:
                    parsed = _value(declaration, field, parent, viewport, font_size)
                    if field != "font_size":
                        changes[field] = parsed
                    break
                except ValueError as error:
                    detail, excerpt = str(error).rstrip("."), repr(declaration.text.strip()[:40])
                    kind = kind_of_refused(declaration.text)
                    note(kind, name, detail if excerpt in detail else f"{detail} ({excerpt})")
    return parent._replace(**(_NOT_INHERITED | changes))


_FIELDS = {name.replace("_", "-"): name for name in Style._fields} | {
    "background": "background_color"
}


def _is_unsupported(name: str, value: str, is_css: bool) -> bool:
    """Whether a declaration changes the image in browsers, but has no effect here."""
    harmless = UNSUPPORTED.get(name) or (_UNSUPPORTED_IN_CSS.get(name) if is_css else None)
    return harmless is not None and value.strip() not in harmless


class _Declaration(NamedTuple):
    """One declaration: a property, its text, and whether it is from CSS, not from an attribute."""

    name: str
    text: str
    is_css: bool


def _by_rank(declared: Declarations, name: str) -> list[_Declaration]:
    """The declarations of a property, highest rank first."""
    declarations = [_Declaration(name, text, True) for text in declared.css_values(name)]
    if name in declared.attributes and name not in _CSS_ONLY:
        declarations.append(_Declaration(name, declared.attributes[name], False))
    return declarations


def _value(
    declaration: _Declaration, field: str, parent: Style, viewport: Viewport, font_size: float
) -> Any:
    """Parse a declaration to the value of the field `field` of `Style`.

    - `parent`: style of the parent, for `inherit` and relative values.
    - `font_size`: of the element, in user units, for `em`.

    Raises `ValueError` for text that is no value of the property.
    """
    text = declaration.text.strip()
    if declaration.name in _WITH_UNITS and declaration.is_css:
        # Lengths may lack a unit in the attribute alone.
        for word in text.split():
            if is_number(word) and finite(word):
                raise ValueError("has no unit, such as `px`")
    if declaration.name == "background":
        return _background(text)
    keyword = text.lower()
    if keyword in ("inherit", "initial", "unset", "revert", "revert-layer"):
        is_inherited = field not in _NOT_INHERITED
        takes_parent = keyword == "inherit" or (is_inherited and keyword != "initial")
        return getattr(parent if takes_parent else INITIAL, field)
    return _PARSERS[field](text, parent, viewport, font_size)


def _paint(text: str, *_: object) -> Paint:
    """Parse the value of `fill` or `stroke`. Raises `ValueError` for text that is no paint."""
    if match := _URL.match(text):
        reference = match[1] or match[2] or match[3] or ""
        fallback = text[match.end() :].strip()
        return PaintServer(reference, _solid(fallback) if fallback else False)
    return _solid(text)


def _solid(text: str) -> Rgba | str | None:
    """Parse a paint without a reference: a colour, `CURRENT`, or None for `none`.

    Raises `ValueError` for any other text.
    """
    if text.lower() == "none":
        return None
    color = color_of(text)
    if color is None:
        raise ValueError("is no paint")
    return color


def _color(text: str, parent: Style, *_: object) -> Any:
    color = color_of(text)
    if color is None:
        raise ValueError("is no colour")
    return parent.color if color == CURRENT else color


def _background(text: str) -> Any:
    """The colour in a `background` shorthand; transparent if it names no colour."""
    for word in _WORD.findall(text):
        if (color := color_of(word)) is not None:
            return color
    return INITIAL.background_color


def _color_or_current(text: str, *_: object) -> Any:
    color = color_of(text)
    if color is None:
        raise ValueError("is no colour")
    return color


def _opacity(text: str, *_: object) -> float:
    return fraction(text)


def _one_of(*words: str) -> Callable[..., str]:
    def parse(text: str, *_: object) -> str:
        if text.lower() not in words:
            raise ValueError(f"is none of {', '.join(words)}")
        return text.lower()

    return parse


def _words_of(*known: str) -> Callable[..., str]:
    def parse(text: str, *_: object) -> str:
        words = text.lower().split()
        if not words or not set(words) <= set(known):
            raise ValueError(f"has words other than {', '.join(known)}")
        return " ".join(words)

    return parse


_display = _words_of(
    "none", "contents", "block", "inline", "flow", "flow-root", "table", "flex", "grid", "ruby",
    "run-in", "list-item", "inline-block", "inline-table", "inline-flex", "inline-grid", "math",
    "table-row-group", "table-header-group", "table-footer-group", "table-row", "table-cell",
    "table-column-group", "table-column", "table-caption", "compact", "marker",
)  # fmt: skip


def _stroke_width(text: str, _: Style, viewport: Viewport, font_size: float) -> float:
    width = viewport.length(text, viewport.diagonal, font_size)
    if width < 0:
        raise ValueError("must not be negative")
    return width


def _miterlimit(text: str, *_: object) -> float:
    try:
        limit = finite(text)
    except ValueError:
        raise ValueError("is not a finite number") from None
    if limit < 1:
        raise ValueError("must be at least 1")
    return limit


def _dasharray(text: str, _: Style, viewport: Viewport, font_size: float) -> tuple[float, ...]:
    if text.lower() == "none":
        return ()
    words = text.replace(",", " ").split()
    lengths = tuple(viewport.length(word, viewport.diagonal, font_size) for word in words)
    if any(value < 0 for value in lengths):
        raise ValueError("must not be negative")
    # An odd list is repeated once. A list of zeros is a solid line.
    return lengths * (1 + len(lengths) % 2) if sum(lengths) > 0 else ()


def _dashoffset(text: str, _: Style, viewport: Viewport, font_size: float) -> float:
    return viewport.length(text, viewport.diagonal, font_size)


def _paint_order(text: str, *_: object) -> tuple[str, ...]:
    words = text.lower().split()
    if words == ["normal"]:
        words = []
    known = ("fill", "stroke", "markers")
    if len(set(words)) < len(words) or not set(words) <= set(known):
        raise ValueError("is no order of fill, stroke and markers")
    order = words + [word for word in known if word not in words]
    return tuple(word for word in order if word != "markers")


def _computed_font_size(declared: Declarations, parent: Style, viewport: Viewport) -> float:
    """The font size of an element, in user units.

    In CSS, whichever of `font-size` and `font` takes effect later counts. Invalid values have no
    effect, and are not noted here.
    """
    size = parent.font_size
    # The properties in `css` are in the order in which they take effect.
    names = [name for name in declared.css if name in ("font", "font-size")]
    for name in names if "font-size" in names else ["font-size", *names]:
        if name == "font":
            size_of_font = shorthand_size(declared.css[name], parent.font_size, viewport)
            size = size if size_of_font is None else size_of_font
            continue
        for declaration in _by_rank(declared, name):
            with contextlib.suppress(ValueError):
                size = _value(declaration, "font_size", parent, viewport, size)
                break
    return size


def _note_invalid_font(text: str, parent: Style, viewport: Viewport, note: Note) -> None:
    if shorthand_size(text, parent.font_size, viewport) is None:
        note(INVALID, "font", f"has no size with a unit ({text.strip()[:40]!r})")


def _font_size(text: str, parent: Style, viewport: Viewport, _: float) -> float:
    return font_size_of(text, parent.font_size, viewport)


def _clip_path(text: str, *_: object) -> str | None:
    if text.lower() == "none":
        return None
    return text


def reference_of(text: str) -> str | None:
    """The reference in a text that begins with `url(...)`, such as `#id`; None for other text."""
    match = _URL.match(text)
    return (match[1] or match[2] or match[3] or "") if match else None


def _any_text(text: str, *_: object) -> str:
    return text


_PARSERS: dict[str, Callable[..., Any]] = {
    "fill": _paint,
    "stroke": _paint,
    "color": _color,
    "fill_opacity": _opacity,
    "stroke_opacity": _opacity,
    "fill_rule": _one_of("nonzero", "evenodd"),
    "clip_rule": _one_of("nonzero", "evenodd"),
    "stroke_width": _stroke_width,
    "stroke_linecap": _one_of("butt", "square", "round"),
    "stroke_linejoin": _one_of("miter", "bevel", "round", "miter-clip", "arcs"),
    "stroke_miterlimit": _miterlimit,
    "stroke_dasharray": _dasharray,
    "stroke_dashoffset": _dashoffset,
    "paint_order": _paint_order,
    "visibility": _one_of("visible", "hidden", "collapse"),
    "font_size": _font_size,
    "opacity": _opacity,
    "display": _display,
    "overflow": _words_of("visible", "hidden", "scroll", "auto", "clip"),
    "vector_effect": _words_of(*_VECTOR_EFFECTS),
    "clip_path": _clip_path,
    "transform_origin": _any_text,
    "transform_box": _one_of("view-box", "fill-box", "stroke-box", "content-box", "border-box"),
    "stop_color": _color_or_current,
    "stop_opacity": _opacity,
    "background_color": _color_or_current,
}
