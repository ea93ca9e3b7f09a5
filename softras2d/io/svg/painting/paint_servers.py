"""Reads the elements `linearGradient` and `radialGradient`, and the references between them."""

import math
from typing import Any, Literal

import numpy as np

from ....geometry import affine_maps
from ..canvas.paint import Stop
from ..elements.css_transform import Units
from ..elements.element_kinds import report_animations
from ..elements.element_transform import about_origin
from ..elements.page import Page, as_affine
from ..elements.view_box import Box
from ..values.css_color import CURRENT, Rgba
from ..values.numbers import fraction
from ..values.transform_attribute import transform_list
from ..values.units import MEDIUM
from ..xml.notices import INVALID
from ..xml.tree import Element
from .gradient_pieces import Gradient, LinearGradient, RadialGradient

GRADIENTS = ("linearGradient", "radialGradient")

Fill = Rgba | Gradient | None
"""What a paint server paints: one colour, a gradient, or None for nothing."""

_TOUCHING = 1e-3
"""Distance below which two circles count as touching, as a fraction of the end circle's radius."""

_MAX_TEMPLATES = 1000
"""Maximum number of references that are followed from one gradient to the next."""


def gradient_fill(
    page: Page, gradient: Element, box: Box, map3: np.ndarray, opacity: float
) -> Fill | Literal[False]:
    """The paint of a gradient element for one shape.

    - `box`: bounding box of the shape in user units.
    - `map3`: homogeneous map `[3, 3]` from the shape's user units to pixels.
    - `opacity`: factor of the alpha of all colours, in 0..1; ignored if the reader does not apply
      opacities.

    Returns a colour if the gradient has a single stop, a radius of 0, or a line whose length is 0
    or infinite. Returns None if it paints nothing: without stops, if this colour is fully
    transparent, if both circles are equal, or if its map is not finite or all but singular. If a
    gradient of several stops is relative to a box without area, returns False; the caller then
    paints the fallback of the reference. Raises `ValueError` for several stops under a map in
    perspective.

    **Source:** SVG 2, section 14.2.
    """
    chain = _templates(page, gradient)
    stops = _stops(page, chain, opacity)
    if not stops:
        return None
    if len(stops) == 1:
        return _solid(stops[0])
    units = _inherited(page, chain, "gradientUnits", ("userSpaceOnUse", "objectBoundingBox"))
    in_box = units != "userSpaceOnUse"
    to_pixels = as_affine(map3)
    if in_box:
        if box.width <= 0 or box.height <= 0:
            return False
        to_pixels = to_pixels @ affine_maps.matrix(box.width, 0.0, 0.0, box.height, box.x, box.y)
    to_pixels = to_pixels @ _gradient_transform(page, chain, in_box)
    if not np.isfinite(to_pixels).all() or abs(np.linalg.det(to_pixels)) < 1e-30:
        return None
    spread = _inherited(page, chain, "spreadMethod", ("pad", "reflect", "repeat")) or "pad"
    if gradient.name == "linearGradient":
        return _linear(page, chain, stops, spread, to_pixels, in_box)
    return _radial(page, chain, stops, spread, to_pixels, in_box)


def _templates(page: Page, gradient: Element) -> list[Element]:
    """A gradient, followed by the gradient to which it refers, and so on.

    A reference to something else, or to a gradient that is in the chain already, is noted and ends
    the chain. At most `_MAX_TEMPLATES` references are followed; one more is noted too.
    """
    chain, visited = [gradient], {id(gradient)}
    while (href := chain[-1].attrib.get("href")) is not None:
        target = page.target(href)
        if target is None or target.name not in GRADIENTS:
            page.report(chain[-1])(INVALID, "href", f"refers to no gradient ({href[:40]!r})")
            break
        if id(target) in visited or len(chain) > _MAX_TEMPLATES:
            page.report(chain[-1])(INVALID, "href", "refers to itself")
            break
        visited.add(id(target))
        chain.append(target)
    return chain


def pattern_applies(pattern: Element, box: Box) -> bool:
    """Whether a browser applies a pattern to a shape with this bounding box, in user units.

    It does not if the pattern is relative to a box without area: the browser then paints the
    fallback. A pattern that inherits attributes from another pattern counts as applied.

    **Source:** SVG 2, section 14.3.
    """
    units = pattern.attrib.get("patternUnits", "").strip()
    return units == "userSpaceOnUse" or "href" in pattern.attrib or min(box.width, box.height) > 0


def _inherited(page: Page, chain: list[Element], name: str, words: tuple[str, ...]) -> str | None:
    """The value of an attribute of the first gradient in `chain` that has the attribute.

    Returns None if no gradient has it, or if the value is none of `words`, which is noted.
    """
    for gradient in chain:
        if (text := gradient.attrib.get(name)) is not None:
            if text.strip() in words:
                return text.strip()
            page.report(gradient)(INVALID, name, f"is none of {', '.join(words)} ({text[:40]!r})")
            return None
    return None


def _gradient_transform(page: Page, chain: list[Element], in_box: bool) -> np.ndarray:
    """The map `[3, 3]` of `gradientTransform`, about the gradient's `transform-origin`.

    It maps the gradient's units to themselves; without the attribute, it is the identity. The
    attribute is read from the first gradient in `chain` that has it. `in_box` says whether the
    gradient's units are the sides of the shape's bounding box, instead of user units. An invalid
    transform, or one without an inverse, is noted and counts as the identity.
    """
    for gradient in chain:
        if (text := gradient.attrib.get("gradientTransform")) is None:
            continue
        report = page.report(gradient)
        try:
            transform = transform_list(text)
            if np.linalg.det(transform) == 0:
                raise ValueError("has no inverse")
        except ValueError as error:
            report(INVALID, "gradientTransform", str(error))
            break
        style, viewport = page.style_in_document(gradient), page.viewport
        box = Box(0.0, 0.0, 1.0, 1.0) if in_box else Box(0.0, 0.0, viewport.width, viewport.height)
        return about_origin(transform, style, Units(viewport, box, style.font_size), report)
    return affine_maps.identity()


def _stops(page: Page, chain: list[Element], opacity: float) -> list[Stop]:
    """The stops of the first gradient in `chain` that has any; empty if none has.

    Their offsets do not decrease. The alpha of each stop is multiplied by `opacity`, unless the
    reader does not apply opacities.
    """
    stops = page.gradient_stops.get(id(chain[0]))
    if stops is None:
        children: list[Element] = []
        for gradient in chain:
            report_animations(page, gradient)
            children = [child for child in gradient.children if child.name == "stop"]
            if children:
                break
        stops = _in_order([_stop(page, child) for child in children])
        page.gradient_stops[id(chain[0])] = stops
    page.budget.charge("overlays", len(chain) + len(stops))
    if opacity == 1 or not page.context.opacity:
        return stops
    return [Stop(stop.offset, stop.color * [1.0, 1.0, 1.0, opacity]) for stop in stops]


def _stop(page: Page, element: Element) -> Stop:
    """The stop that an element `stop` declares. An invalid offset is noted and counts as 0."""
    report_animations(page, element)
    style = page.style_in_document(element)
    color: Any = style.color if style.stop_color == CURRENT else style.stop_color
    offset = 0.0
    if (text := element.attrib.get("offset")) is not None:
        try:
            offset = fraction(text)
        except ValueError as error:
            page.report(element)(INVALID, "offset", str(error))
    alpha = color[3] * style.stop_opacity if page.context.opacity else 1.0
    return Stop(offset, np.array([*color[:3], alpha]))


def _in_order(stops: list[Stop]) -> list[Stop]:
    """Make stops whose offsets do not decrease: each is raised to the largest one before it."""
    ordered: list[Stop] = []
    for stop in stops:
        offset = max(stop.offset, ordered[-1].offset) if ordered else stop.offset
        ordered.append(Stop(offset, stop.color))
    return ordered


def _solid(stop: Stop) -> Rgba | None:
    """The colour of a stop; None if it is fully transparent."""
    red, green, blue, alpha = stop.color.tolist()
    return (red, green, blue, alpha) if alpha > 0 else None


class _Lengths:
    """Reads lengths of a gradient, in the gradient's units.

    - `chain`: the gradient, followed by those to which it refers. A length is read from the first
      gradient of the same kind that has it.
    - `in_box`: whether the units are the sides of the shape's bounding box, instead of user units.
    """

    def __init__(self, page: Page, chain: list[Element], in_box: bool):
        self._page = page
        self._chain = [gradient for gradient in chain if gradient.name == chain[0].name]
        self._in_box = in_box

    def read(self, name: str, default: str | float) -> float:
        """The length of an attribute; `default` if it is missing or invalid, which is noted.

        `default` is text to parse, or a length in the gradient's units. Percentages in user units
        are relative to the width of the viewport for x, to its height for y, and to its diagonal
        for radii. In units of the bounding box, 100 % is 1.
        """
        viewport = self._page.viewport
        full = {"x": viewport.width, "y": viewport.height}.get(
            name[-1] if name[-1] in "xy" else name[0], viewport.diagonal
        )
        full = 1.0 if self._in_box else full
        for gradient in self._chain:
            if (text := gradient.attrib.get(name)) is not None:
                try:
                    font_size = self._page.style_in_document(gradient).font_size
                    return viewport.length(text, full, font_size)
                except ValueError as error:
                    self._page.report(gradient)(INVALID, name, str(error))
                    break
        return viewport.length(default, full, MEDIUM) if isinstance(default, str) else default


def _linear(
    page: Page,
    chain: list[Element],
    stops: list[Stop],
    spread: str,
    to_pixels: np.ndarray,
    in_box: bool,
) -> Fill:
    """The paint of a `linearGradient`; the colour of the last stop for a length of 0 or infinity.

    - `chain`: the gradient, followed by those to which it refers.
    - `stops`: at least two, with offsets that do not decrease.
    - `spread`: `pad`, `reflect` or `repeat`.
    - `to_pixels`: map `[3, 3]` from the gradient's units to pixels.
    - `in_box`: whether these units are the sides of the shape's bounding box, instead of user
      units.

    Returns None instead of a colour that is fully transparent.
    """
    lengths = _Lengths(page, chain, in_box)
    x1, y1 = lengths.read("x1", "0%"), lengths.read("y1", "0%")
    x2, y2 = lengths.read("x2", "100%"), lengths.read("y2", "0%")
    squared = (x2 - x1) ** 2 + (y2 - y1) ** 2
    if not 0 < squared < math.inf:
        return _solid(stops[-1])
    along = np.array([x2 - x1, y2 - y1, 0.0]) / squared
    along[2] = -(along[0] * x1 + along[1] * y1)
    return LinearGradient(tuple(stops), spread, along @ np.linalg.inv(to_pixels))


def _radial(
    page: Page,
    chain: list[Element],
    stops: list[Stop],
    spread: str,
    to_pixels: np.ndarray,
    in_box: bool,
) -> Fill:
    """The paint of a `radialGradient`; the colour of the last stop if the end circle's radius is 0.

    The arguments are as for `_linear`. Returns None if both circles are equal, and for a radius of
    0 if the last stop is fully transparent. If the start circle is larger, both circles are swapped
    and the stops reversed. If the smaller circle touches the larger one from inside, it is moved
    inwards a little. A negative radius is noted, and replaced by the default.
    """
    lengths = _Lengths(page, chain, in_box)
    cx, cy, r = (lengths.read(name, "50%") for name in ("cx", "cy", "r"))
    fx, fy, fr = lengths.read("fx", cx), lengths.read("fy", cy), lengths.read("fr", 0.0)
    report = page.report(chain[0])
    if r < 0:
        report(INVALID, "r", "must not be negative")
        r = 0.5 if in_box else 0.5 * page.viewport.diagonal
    if fr < 0:
        report(INVALID, "fr", "must not be negative")
        fr = 0.0
    if r == 0:
        return _solid(stops[-1])
    center, focus = (cx, cy), (fx, fy)
    if fr > r:
        # Swap both ends: the gradient stays the same, and its circles then grow.
        center, focus, r, fr = focus, center, fr, r
        stops = [Stop(1.0 - stop.offset, stop.color) for stop in reversed(stops)]
    distance = math.hypot(focus[0] - center[0], focus[1] - center[1])
    if fr == r and distance == 0:
        # SVG 2, section 14.2.3.2: no gradient is drawn if both circles are the same.
        return None
    if distance > 0 and fr < r and abs(distance + fr - r) < r * _TOUCHING:
        # If the start circle touches the end circle from inside, rays near the common tangent have
        # no length. The focus is therefore moved inwards.
        t = max(r * (1 - _TOUCHING) - fr, 0.0) / distance
        focus = (
            center[0] + (focus[0] - center[0]) * t,
            center[1] + (focus[1] - center[1]) * t,
        )
    return RadialGradient(tuple(stops), spread, to_pixels, center, r, focus, fr)
