"""Turns shape elements into paths, with SVG's rules for missing and invalid attributes.

To add a shape, write a function here that makes its path from `ElementLengths`, and put it into
`SHAPES`; attributes that style sheets may set go into `_GEOMETRY`. Clip paths, bounding boxes,
`use` and `switch` then know the shape. Helpers that make paths are in `values.path_data`. The
dialect "course" has its own table, `CourseReader._shapes`.
"""

import math
from collections.abc import Callable

from ...shapes.paths import Path
from ..css.cascade import Declarations
from ..css.style import Style
from ..values.numbers import leading_numbers
from ..values.path_data import ellipse_path, parse_path_data, polygon_path, rect_path
from ..xml.notices import INVALID, kind_of_refused
from ..xml.tree import Element
from .page import Page

_GEOMETRY = {
    # Attributes that style sheets can set too (SVG 2, chapter 7 and section 9.3.2).
    "circle": ("cx", "cy", "r"),
    "ellipse": ("cx", "cy", "rx", "ry"),
    "rect": ("x", "y", "width", "height", "rx", "ry"),
    "image": ("x", "y", "width", "height"),
    "svg": ("x", "y", "width", "height"),
    "symbol": ("x", "y", "width", "height"),
    "use": ("x", "y", "width", "height"),
    "path": ("d",),
}


class ElementLengths:
    """Reads the geometry attributes and properties of an element, and notes invalid ones.

    - `declared`: declarations of the element, since style sheets may set some of the lengths.
    - `style`: computed style of the element, for its font size.
    - `page`: percentages are relative to its `viewport` at the time of reading.
    """

    def __init__(self, page: Page, element: Element, declared: Declarations, style: Style):
        self._page = page
        self._element = element
        self._declared = declared
        self._style = style
        self.report = page.report(element)

    def text(self, name: str) -> str | None:
        """The text of an attribute, or of the CSS property of the same name, which outranks it.

        The property may be given in a style sheet or in the attribute `style`. It counts only if it
        applies to this element. Returns None if neither the attribute nor the property is given.
        """
        values = self._css_values(name)
        return values[0] if values else self._element.attrib.get(name)

    def _css_values(self, name: str) -> list[str]:
        """The texts of the property `name` in CSS, highest rank first.

        Empty if neither a style sheet nor the attribute `style` sets the property, or if it does
        not apply to this element.
        """
        if name not in _GEOMETRY.get(self._element.name, ()):
            return []
        return self._declared.css_values(name)

    def read(self, name: str, default: float = 0.0) -> float:
        """A length in user units; `default` if it is missing, invalid, or a keyword such as `auto`.

        Percentages are relative to the viewport: to its width for `x`, `x1`, `x2`, `cx`, `width`
        and `rx`, to its diagonal for `r`, and to its height for all other names. Declarations in
        CSS outrank the attribute. An invalid one is noted, and that of the next lower rank is read.
        """
        viewport = self._page.viewport
        if name in ("x", "x1", "x2", "cx", "width", "rx"):
            full = viewport.width
        elif name == "r":
            full = viewport.diagonal
        else:
            full = viewport.height
        candidates = [(text, viewport.css_length) for text in self._css_values(name)]
        if (text := self._element.attrib.get(name)) is not None:
            candidates.append((text, viewport.length))
        for text, parse in candidates:
            if text.strip() in ("auto", "inherit", "initial", "unset"):
                return default
            try:
                return parse(text, full, self._style.font_size)
            except ValueError as error:
                self.report(kind_of_refused(text), name, str(error))
        return default

    def size(self, name: str, default: float = 0.0) -> float:
        """A length in user units, read as `read` does, that must not be negative.

        A negative length is noted, and the result is then `default`.
        """
        value = self.read(name, default)
        if value < 0:
            self.report(INVALID, name, "must not be negative")
            return default
        return value


def _rect(lengths: ElementLengths) -> Path | None:
    """The path of a `rect`; None if it has no width or no height.

    A corner radius that is missing, invalid or `auto` equals the other one; without both, corners
    are sharp. Radii are at most half of the sides.
    """
    width, height = lengths.size("width"), lengths.size("height")
    if width <= 0 or height <= 0:
        return None
    rx, ry = lengths.size("rx", math.nan), lengths.size("ry", math.nan)
    rx, ry = (ry if math.isnan(rx) else rx), (rx if math.isnan(ry) else ry)
    rx, ry = (0.0 if math.isnan(radius) else radius for radius in (rx, ry))
    x, y = lengths.read("x"), lengths.read("y")
    return rect_path(x, y, width, height, min(rx, width / 2), min(ry, height / 2))


def _circle(lengths: ElementLengths) -> Path | None:
    """The path of a `circle`; None if it has no radius."""
    radius = lengths.size("r")
    if radius <= 0:
        return None
    return ellipse_path(lengths.read("cx"), lengths.read("cy"), radius, radius)


def _ellipse(lengths: ElementLengths) -> Path | None:
    """The path of an `ellipse`; None if it has no area.

    A radius that is missing, invalid or `auto` equals the radius of the other axis.
    """
    rx, ry = lengths.size("rx", math.nan), lengths.size("ry", math.nan)
    # A radius that is missing or `auto` equals the radius of the other axis.
    rx, ry = (ry if math.isnan(rx) else rx), (rx if math.isnan(ry) else ry)
    if not (rx > 0 and ry > 0):
        return None
    return ellipse_path(lengths.read("cx"), lengths.read("cy"), rx, ry)


def _line(lengths: ElementLengths) -> Path:
    """The path of a `line`.

    Its points are in `Path.fixed`: they do not count as control points, since the file does not
    give them by a list of points.
    """
    x1, y1, x2, y2 = (lengths.read(name) for name in ("x1", "y1", "x2", "y2"))
    path = polygon_path([(x1, y1), (x2, y2)], False)
    path.fixed = {0, 1}
    return path


def _points(lengths: ElementLengths, closed: bool) -> Path:
    """The path of a `polygon`, if `closed` is true, or of a `polyline`.

    It has the points before the first error in the attribute `points`. The error, or an odd number
    of coordinates, is noted.
    """
    numbers, error = leading_numbers(lengths.text("points") or "")
    if error is None and len(numbers) % 2:
        error = "has an odd number of coordinates"
    if error is not None:
        lengths.report(INVALID, "points", error)
    return polygon_path(list(zip(numbers[0::2], numbers[1::2], strict=False)), closed)


def _path(lengths: ElementLengths) -> Path:
    """The path of an element `path`, up to the first error in its path data, which is noted.

    Path data may stand in the attribute `d`, or in the CSS property `d` as `path("...")`.
    """
    text = lengths.text("d") or ""
    if text.strip().startswith("path("):
        text = text.strip()[5:].rstrip(") ").strip("\"' ")
    path, error = parse_path_data(text)
    if error is not None:
        lengths.report(INVALID, "d", error)
    return path


SHAPES: dict[str, Callable[[ElementLengths], Path | None]] = {
    "circle": _circle,
    "ellipse": _ellipse,
    "line": _line,
    "path": _path,
    "polygon": lambda lengths: _points(lengths, True),
    "polyline": lambda lengths: _points(lengths, False),
    "rect": _rect,
}
"""The function that makes the path of each shape element, in user units, by name of the element.

The function returns None for a shape that is not drawn, such as a rect without width.
"""
