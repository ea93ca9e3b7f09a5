"""Computes the style of an element from its declarations and the style of its parent."""

import contextlib
from collections.abc import Callable
from typing import Any, NamedTuple

from ..values.numbers import finite, is_number
from ..values.units import Viewport
from ..xml.notices import INVALID, WITHOUT_EFFECT, kind_of_refused
from .cascade import Declarations
from .font_size import shorthand_size
from .property_values import PARSERS, background_color
from .style import INITIAL, NOT_INHERITED, Style

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
"""Supported properties that are not presentation attributes: only CSS can set them."""

_WITH_UNITS = ("font-size", "transform-origin")
"""Properties whose lengths need a unit in CSS, unlike lengths of strokes (SVG 2, section 13.5)."""

Note = Callable[[str, str, str], None]
"""Function that is called about a fault in a declaration.

Its arguments are the kind of notice (`notices.py`), the name of the property, and what is wrong.
"""


def computed(declared: Declarations, parent: Style, viewport: Viewport, note: Note) -> Style:
    """Compute the style of an element from its declarations and the style of its parent.

    - `viewport`: sizes to which lengths and percentages are relative.
    - `note`: called for each invalid declaration that no valid one of the same property outranks.
      Of `font`, only the value of highest rank in CSS is checked. `note` is also called for values
      of properties in `UNSUPPORTED` or `_UNSUPPORTED_IN_CSS` that may change the image and are not
      outranked.

    An invalid declaration has no effect: the declaration of the next lower rank is used instead.
    Without a valid declaration, a property has its parent's value if it is inherited, and its
    initial value otherwise.
    """
    # Computed first, since other lengths may depend on it. Invalid declarations of it are noted
    # below.
    font_size = _computed_font_size(declared, parent, viewport)
    changes: dict[str, Any] = {"font_size": font_size}
    for source in (declared.attributes, declared.css):
        for name, value in source.items():
            if source is declared.attributes and name in declared.css:
                continue
            field = _FIELDS.get(name)
            if field is None or (name in _CSS_ONLY and source is declared.attributes):
                if _is_unsupported(name, value, source is declared.css):
                    note(WITHOUT_EFFECT, name, value)
                if name == "font" and source is declared.css:
                    _note_invalid_font(value, parent, viewport, note)
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
    return parent._replace(**(NOT_INHERITED | changes))


_FIELDS = {name.replace("_", "-"): name for name in Style._fields} | {
    "background": "background_color"
}


def _is_unsupported(name: str, value: str, is_css: bool) -> bool:
    """Whether a declaration may change the image in browsers, but has no effect in this reader.

    - `name`, `value`: the property and the text of its value. Values are harmless only if they are
      in the tables, in upper or lower case.
    - `is_css`: whether the declaration is in CSS, rather than an attribute of the element. The
      properties of `_UNSUPPORTED_IN_CSS` have an effect in CSS alone.
    """
    harmless = UNSUPPORTED.get(name) or (_UNSUPPORTED_IN_CSS.get(name) if is_css else None)
    return harmless is not None and value.strip().lower() not in harmless


class _Declaration(NamedTuple):
    """One declaration of a property: the name of the property, and the text of its value.

    `is_css` is True for a style sheet or the attribute `style`, and False for an attribute that is
    named after the property.
    """

    name: str
    text: str
    is_css: bool


def _by_rank(declared: Declarations, name: str) -> list[_Declaration]:
    """The declarations of a property, highest rank first. A presentation attribute comes last."""
    declarations = [_Declaration(name, text, True) for text in declared.css_values(name)]
    if name in declared.attributes and name not in _CSS_ONLY:
        declarations.append(_Declaration(name, declared.attributes[name], False))
    return declarations


def _value(
    declaration: _Declaration, field: str, parent: Style, viewport: Viewport, font_size: float
) -> Any:
    """Parse a declaration to the value of the field `field` of `Style`.

    - `parent`: style of the parent, for `inherit` and relative values.
    - `viewport`: sizes to which lengths and percentages are relative.
    - `font_size`: font size of the element in user units, to which `em` is relative.

    `inherit` gives the value of the parent, and `initial` the initial value. `unset`, `revert` and
    `revert-layer` mean `inherit` for an inherited property, and `initial` for any other. Raises
    `ValueError` for a length that lacks its unit (`_WITH_UNITS`), for a `background` that is
    invalid, and for text that the parser in `PARSERS` refuses.
    """
    text = declaration.text.strip()
    if declaration.name in _WITH_UNITS and declaration.is_css:
        # Lengths may lack a unit in the attribute alone.
        for word in text.split():
            if is_number(word) and finite(word):
                raise ValueError("has no unit, such as `px`")
    keyword = text.lower()
    if keyword in ("inherit", "initial", "unset", "revert", "revert-layer"):
        is_inherited = field not in NOT_INHERITED
        takes_parent = keyword == "inherit" or (is_inherited and keyword != "initial")
        return getattr(parent if takes_parent else INITIAL, field)
    if declaration.name == "background":
        return background_color(text)
    return PARSERS[field](text, parent, viewport, font_size)


def _computed_font_size(declared: Declarations, parent: Style, viewport: Viewport) -> float:
    """The font size of an element, in user units.

    The properties `font-size` and `font` both set the font size. Of these two, the one that has the
    declaration of highest rank counts, unless it has no valid value; then the other one counts. Of
    `font`, only the value of highest rank in CSS is considered. Without a valid value of either,
    the result is the parent's font size. Invalid values are not noted here, since `computed` notes
    them.
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
    """Call `note` for a value of the shorthand `font` without a valid font size."""
    if shorthand_size(text, parent.font_size, viewport) is None:
        note(INVALID, "font", f"has no size with a unit ({text.strip()[:40]!r})")
