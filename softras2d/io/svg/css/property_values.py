"""Parses the values of CSS properties.

To add a property: add a field to `style.Style`, before `opacity` if it is inherited, and its parser
to `PARSERS` here; remove it from the properties that are not supported (`computed_style.py`).
"""

import re
from collections.abc import Callable
from typing import Any

import tinycss2

from ..values.css_color import CURRENT, Rgba, color_of, nesting
from ..values.numbers import finite, fraction
from ..values.units import Viewport
from .font_size import font_size_of
from .style import INITIAL, Paint, PaintServer, Style

_URL = re.compile(r"url\(\s*+(?:\"([^\"]*+)\"|'([^']*+)'|([^()\"'\s]*+))\s*+\)\s*+")
"""Matches `url(...)` and the blanks after it. One of its three groups is the reference."""

_MAX_NESTING = 32
"""Maximum depth of nested brackets in `background`, since tinycss2 recurses for each bracket.

A value with deeper brackets is invalid.
"""

_BACKGROUND_WORDS = frozenset({
    "auto", "border-box", "bottom", "center", "contain", "content-box", "cover", "fixed", "left",
    "local", "no-repeat", "none", "padding-box", "repeat", "repeat-x", "repeat-y", "right", "round",
    "scroll", "space", "text", "top",
})  # fmt: skip
"""Words that may stand in `background` beside a colour, images and sizes."""


def _paint(text: str, *_: object) -> Paint:
    """Parse the value of `fill` or `stroke`.

    Returns a colour, `CURRENT` for `currentColor`, None for `none`, or a `PaintServer` for text
    that begins with `url(...)`. Raises `ValueError` for text that is no paint.
    """
    if match := _URL.match(text):
        reference = match[1] or match[2] or match[3] or ""
        fallback = text[match.end() :].strip()
        return PaintServer(reference, _solid(fallback) if fallback else False)
    return _solid(text)


def _solid(text: str) -> Rgba | str | None:
    """Parse a paint that is no reference.

    Returns a colour, `CURRENT` for `currentColor`, or None for `none`. Raises `ValueError` for any
    other text.
    """
    if text.lower() == "none":
        return None
    color = color_of(text)
    if color is None:
        raise ValueError("is no paint")
    return color


def _color(text: str, parent: Style, *_: object) -> Any:
    """Parse the property `color`; returns an `Rgba`.

    `currentColor` is the `color` of the parent. Raises `ValueError` for text that is no colour.
    """
    color = color_of(text)
    if color is None:
        raise ValueError("is no colour")
    return parent.color if color == CURRENT else color


def background_color(text: str) -> Any:
    """The colour in a value of the shorthand `background`, as an `Rgba` or `CURRENT`.

    It is the word or function that is a colour, and transparent black if there is none. A colour
    inside of another function, such as a gradient, does not count. Raises `ValueError` for empty
    text, for several colours, for words and numbers that no background has, for `var(...)`, and for
    brackets that are nested too deeply. The order of the parts is not checked.
    """
    if nesting(text) > _MAX_NESTING:
        raise ValueError(f"has brackets that are nested deeper than {_MAX_NESTING}")
    colors = []
    # tinycss2 raises `ValueError` for integers of thousands of digits.
    for token in tinycss2.parse_component_value_list(text):
        if (color := color_of(token.serialize())) is not None:
            colors.append(color)
        elif not _may_stand_in_background(token):
            raise ValueError(f"has the part {token.serialize()[:24]!r}, which no background has")
    if len(colors) > 1 or not text.strip():
        raise ValueError("is no background")
    return colors[0] if colors else INITIAL.background_color


def _may_stand_in_background(token: Any) -> bool:
    """Whether a token of tinycss2 that is no colour may stand in a value of `background`.

    Every function other than `var(...)` may, since it may be an image or a length.
    """
    if token.type == "ident":
        return token.lower_value in _BACKGROUND_WORDS
    if token.type == "function":
        return token.lower_name != "var"
    if token.type == "literal":
        return token.value in ("/", ",")
    if token.type == "number":
        return token.value == 0
    return token.type in ("whitespace", "comment", "url", "dimension", "percentage")


def _color_or_current(text: str, *_: object) -> Any:
    """Parse a colour; returns an `Rgba`, or `CURRENT` for `currentColor`.

    Raises `ValueError` for any other text.
    """
    color = color_of(text)
    if color is None:
        raise ValueError("is no colour")
    return color


def _opacity(text: str, *_: object) -> float:
    """Parse an opacity, a number or a percentage; returns it clamped to 0..1.

    Raises `ValueError` for any other text.
    """
    return fraction(text)


def _one_of(*words: str) -> Callable[..., str]:
    """Make a parser that accepts one of `words` in any case, and returns it in lower case.

    `words` are in lower case. The parser raises `ValueError` for any other text.
    """

    def parse(text: str, *_: object) -> str:
        if text.lower() not in words:
            raise ValueError(f"is none of {', '.join(words)}")
        return text.lower()

    return parse


def _words_of(*known: str) -> Callable[..., str]:
    """Make a parser that accepts one or more of the words in `known`, in any case.

    The parser returns the words in lower case, with single blanks between. It raises `ValueError`
    for empty text and for other words.
    """

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
    """Parse `stroke-width`; returns it in user units.

    Percentages are relative to `viewport.diagonal`. Raises `ValueError` for a negative width, and
    for text that is no length.
    """
    width = viewport.length(text, viewport.diagonal, font_size)
    if width < 0:
        raise ValueError("must not be negative")
    return width


def _miterlimit(text: str, *_: object) -> float:
    """Parse `stroke-miterlimit`. Raises `ValueError` unless it is a finite number of at least 1."""
    try:
        limit = finite(text)
    except ValueError:
        raise ValueError("is not a finite number") from None
    if limit < 1:
        raise ValueError("must be at least 1")
    return limit


def _dasharray(text: str, _: Style, viewport: Viewport, font_size: float) -> tuple[float, ...]:
    """Parse `stroke-dasharray`; returns the lengths of dashes and gaps in turn, in user units.

    An odd number of lengths is repeated once, so the result has an even number. It is empty for a
    solid line: for `none`, for text without lengths, and if all lengths are 0. Percentages are
    relative to `viewport.diagonal`. Raises `ValueError` for a negative length, and for any other
    text.
    """
    if text.lower() == "none":
        return ()
    words = text.replace(",", " ").split()
    lengths = tuple(viewport.length(word, viewport.diagonal, font_size) for word in words)
    if any(value < 0 for value in lengths):
        raise ValueError("must not be negative")
    # An odd list is repeated once. A list of zeros is a solid line.
    return lengths * (1 + len(lengths) % 2) if sum(lengths) > 0 else ()


def _dashoffset(text: str, _: Style, viewport: Viewport, font_size: float) -> float:
    """Parse `stroke-dashoffset`, which may be negative; returns it in user units.

    Percentages are relative to `viewport.diagonal`. Raises `ValueError` for any other text.
    """
    return viewport.length(text, viewport.diagonal, font_size)


def _paint_order(text: str, *_: object) -> tuple[str, ...]:
    """Parse `paint-order`; returns `"fill"` and `"stroke"` in the order of painting.

    Those that the text does not name come last, `"fill"` before `"stroke"`. `normal` alone names
    neither. `markers` is accepted, but left out. Raises `ValueError` for words that are repeated or
    not known.
    """
    words = text.lower().split()
    if words == ["normal"]:
        words = []
    known = ("fill", "stroke", "markers")
    if len(set(words)) < len(words) or not set(words) <= set(known):
        raise ValueError("is no order of fill, stroke and markers")
    order = words + [word for word in known if word not in words]
    return tuple(word for word in order if word != "markers")


def _font_size(text: str, parent: Style, viewport: Viewport, _: float) -> float:
    """Parse `font-size`; returns it in user units. Raises `ValueError` as `font_size_of` does."""
    return font_size_of(text, parent.font_size, viewport)


def _clip_path(text: str, *_: object) -> str | None:
    """Parse `clip-path`: return None for `none`, and any other text unchanged."""
    if text.lower() == "none":
        return None
    return text


def reference_of(text: str) -> str | None:
    """The reference, such as `#id`, in a text that begins with `url(...)`, without its quotes.

    Returns None for a text that does not begin like this, and empty text for `url()`.
    """
    match = _URL.match(text)
    return (match[1] or match[2] or match[3] or "") if match else None


def _any_text(text: str, *_: object) -> str:
    """Accept any text, and return it unchanged."""
    return text


PARSERS: dict[str, Callable[..., Any]] = {
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
    "vector_effect": _one_of(
        "none", "non-scaling-stroke", "non-scaling-size", "non-rotation", "fixed-position"
    ),
    "clip_path": _clip_path,
    "transform_origin": _any_text,
    "transform_box": _one_of("view-box", "fill-box", "stroke-box", "content-box", "border-box"),
    "stop_color": _color_or_current,
    "stop_opacity": _opacity,
    "background_color": _color_or_current,
}
"""The parser of each field of `Style`.

Its arguments are the text of the value without blanks around it, the style of the parent, the
viewport, and the font size of the element in user units. It raises `ValueError` for text that is no
value of the property, but `clip_path` and `transform_origin` accept any text. Keywords that every
property accepts, such as `inherit`, are not parsed here.
"""
