"""Computes the style of elements: presentation attributes, `style`, inheritance and paints."""

import re
from collections.abc import Callable
from typing import NamedTuple

import tinycss2

from .css_color import CURRENT, Rgba, color_of, nesting
from .numbers import finite, fraction, length

_PLAIN_STYLE = re.compile(r"[^\"'\\{}\[\]@/]*+\Z")
_URL = re.compile(r"url\((?:[^()\"']|\"[^\"]*+\"|'[^']*+')*+\)")

_MAX_NESTING = 32
"""Limit of brackets within brackets in a `style` attribute, since tinycss2 recurses for each."""


class Style(NamedTuple):
    """Computed style of an element; its `opacity` includes the factors of all ancestors."""

    fill: Rgba | str | None = (0.0, 0.0, 0.0, 1.0)
    stroke: Rgba | str | None = None
    color: Rgba | str | None = (0.0, 0.0, 0.0, 1.0)
    fill_opacity: float = 1.0
    stroke_opacity: float = 1.0
    opacity: float = 1.0
    fill_rule: str = "nonzero"
    stroke_width: float = 1.0
    stroke_linecap: str = "butt"
    stroke_linejoin: str = "miter"
    stroke_miterlimit: float = 4.0
    display: str = "inline"
    visibility: str = "visible"

    def fill_rgba(self, opacity: bool) -> Rgba | None:
        """The fill colour; None for no fill. If `opacity` is False, it is opaque."""
        return self._rgba(self.fill, self.fill_opacity, opacity)

    def stroke_rgba(self, opacity: bool) -> Rgba | None:
        """The stroke colour; None for no stroke. If `opacity` is False, it is opaque."""
        if self.stroke_width == 0 or (opacity and self.stroke_opacity * self.opacity == 0):
            return None
        return self._rgba(self.stroke, self.stroke_opacity, opacity)

    def _rgba(self, paint: Rgba | str | None, paint_opacity: float, opacity: bool) -> Rgba | None:
        paint = self.color if paint == CURRENT else paint
        if paint is None or isinstance(paint, str) or self.visibility != "visible":
            return None
        red, green, blue, alpha = paint
        if alpha == 0:
            return None
        return red, green, blue, alpha * paint_opacity * self.opacity if opacity else 1.0


INITIAL = Style()

UNSUPPORTED = {
    # Properties that change the image but are not supported, and those of their values that do not
    # change it.
    "clip-path": ("none",),
    "filter": ("none",),
    "marker": ("none",),
    "marker-end": ("none",),
    "marker-mid": ("none",),
    "marker-start": ("none",),
    "mask": ("none",),
    "mix-blend-mode": ("normal",),
    "paint-order": ("normal", "fill", "fill stroke", "fill stroke markers"),
    "stroke-dasharray": ("none",),
    "vector-effect": ("none",),
}


def computed(
    attributes: dict[str, str], parent: Style, diagonal: float, note: Callable[[str], None]
) -> Style:
    """Compute the style of an element from its attributes and the style of its parent.

    - `diagonal`: length, in user units, that a stroke width of 100 % means.
    - `note`: called with the names of properties and values that are not supported.

    Raises `ValueError` for text that is no number where a number is expected.
    """
    declared = attributes
    if "style" in attributes:
        # CSS declarations take precedence over presentation attributes.
        css = _declarations(attributes["style"], note)
        if "transform" in css:
            note("style: transform")
        declared = attributes | css
    changes = {}
    for name, value in declared.items():
        if name in UNSUPPORTED:
            if value.strip() not in UNSUPPORTED[name]:
                note(name)
            continue
        field = name.replace("-", "_")
        if field not in _FIELDS:
            continue
        value = value.strip()
        if value == "inherit":
            # The other properties are inherited anyway.
            if field == "opacity":
                note("opacity: inherit")
            continue
        changes |= _parsed(field, name, value, parent, diagonal, note)
    return parent._replace(**changes) if changes else parent


_FIELDS = frozenset(Style._fields)

_KEYWORDS = {
    "fill_rule": ("nonzero", "evenodd"),
    "stroke_linecap": ("butt", "square", "round"),
    "stroke_linejoin": ("miter", "bevel", "round"),
    "visibility": ("visible", "hidden", "collapse"),
}


def _parsed(
    field: str,
    name: str,
    value: str,
    parent: Style,
    diagonal: float,
    note: Callable[[str], None],
) -> dict[str, object]:
    """Parse one declaration; returns the changed field, or nothing if it is invalid.

    `note` is called for an invalid declaration.
    """
    try:
        if field in ("fill", "stroke", "color"):
            paint = _paint(value, note)
            if paint is not False and (paint is not None or field != "color"):
                # `color: currentColor` means the colour of the parent.
                return {} if field == "color" and paint == CURRENT else {field: paint}
        elif field == "opacity":
            return {field: parent.opacity * fraction(value)}
        elif field in ("fill_opacity", "stroke_opacity"):
            return {field: fraction(value)}
        elif field == "stroke_width":
            if (width := length(value, diagonal)) >= 0:
                return {field: width}
        elif field == "stroke_miterlimit":
            if (limit := finite(value)) >= 1:
                return {field: limit}
        elif field == "display" or value in _KEYWORDS[field]:
            return {field: value}
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    note(f"{name}: {value[:24]}")
    return {}


def _paint(text: str, note: Callable[[str], None]) -> Rgba | str | bool | None:
    """Parse a paint: a colour, None for `none`, False for text that is no paint.

    Paint servers (`url(...)`) are not supported; the fallback colour after them is used.
    """
    if url := _URL.match(text):
        note("url(...) paint")
        text = text[url.end() :].strip()
    if not text or text.lower() == "none":
        return None
    color = color_of(text)
    return False if color is None else color


def _declarations(text: str, note: Callable[[str], None]) -> dict[str, str]:
    """Parse a `style` attribute into values by name; the last of equal names counts."""
    if _PLAIN_STYLE.match(text) and "(" not in text:
        pairs = (declaration.partition(":") for declaration in text.split(";"))
        plain = {name.strip().lower(): value for name, _, value in pairs if name.strip()}
        return {name: _without_important(value) for name, value in plain.items()}
    if nesting(text) > _MAX_NESTING:
        raise ValueError(f"style: brackets are nested deeper than {_MAX_NESTING}.")
    values = {}
    for node in tinycss2.parse_blocks_contents(text, skip_comments=True, skip_whitespace=True):
        if node.type == "declaration":
            values[node.lower_name] = tinycss2.serialize(node.value).strip()
        else:
            note("style: " + text[:24])
    return values


def _without_important(value: str) -> str:
    return value.replace("!important", "").strip()
