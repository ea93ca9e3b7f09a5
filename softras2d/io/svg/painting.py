"""Fills and strokes paths: flattens them, resolves their paints, and passes on what results.

A shape of one colour that is not clipped stays a set of contours or outlines, which the display
list triangulates many at a time. A clipped shape or one with a gradient becomes regions.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import shapely

from ...geometry import affine_maps
from ..shapes.dashes import dashes
from ..shapes.paths import FlatPath, Path, flatten
from ..shapes.regions import filled, intersection, is_empty, polygons_of
from ..shapes.strokes import Outline
from .gradient_pieces import LinearGradient, RadialGradient, linear_pieces, radial_pieces
from .layers import Item
from .notices import INVALID, WITHOUT_EFFECT
from .numbers import finite
from .page import Page
from .paint import flat
from .paint_servers import GRADIENTS, Fill, gradient_fill
from .sinks import Sink, stroked
from .style import CURRENT, PaintServer, Style
from .tree import Element
from .view_box import Box


class Place(NamedTuple):
    """Where an element is drawn.

    - `map3`: homogeneous map `[3, 3]` from the element's units to pixels.
    - `scale`: largest stretch of `map3`, in pixels per unit.
    - `clip`: the region that is shown, in pixels; None for the whole plane.
    - `sink`: what receives the shapes.
    """

    map3: np.ndarray
    scale: float
    clip: Any
    sink: Sink


class Source(NamedTuple):
    """A fill with its control points, for `control_points.py`."""

    element: Element
    path: Path
    outline: FlatPath
    map3: np.ndarray


class Painter:
    """Paints the shapes of a page.

    `sources` are the fills whose control points are kept, if `keeps_sources`.
    """

    def __init__(self, page: Page):
        self._page = page
        self.sources: list[Source] = []
        self.keeps_sources = False

    def paint(
        self, element: Element, path: Path, style: Style, place: Place, opacity: float
    ) -> None:
        """Fill and stroke a path in the order that its style gives."""
        if style.visibility != "visible":
            return
        linear = place.map3[:2, :2] / (place.map3[2, 2] or 1.0)
        outline = flatten(path, linear, self._page.tolerance, self._page.budget)
        for kind in style.paint_order:
            if kind == "fill":
                self._fill(element, path, outline, style, place, opacity)
            else:
                self._stroke(element, outline, style, place, opacity)

    def paints_both(self, style: Style) -> bool:
        """Whether a shape of this style may have a fill and a stroke."""
        return style.fill is not None and style.stroke is not None and style.stroke_width > 0

    def _fill(
        self, element: Element, original: Path, path: FlatPath, style: Style, place: Place,
        opacity: float,
    ) -> None:  # fmt: skip
        if style.fill is None or element.name == "line" or len(path.points) < 3:
            return
        fill = self.resolved(
            element, "fill", style.fill, style, style.fill_opacity * opacity, path, place
        )
        if fill is None:
            return
        points = affine_maps.apply(place.map3, path.points)
        contours = [contour for contour in path.contours(points) if len(contour) > 2]
        if not contours:
            return
        evenodd = style.fill_rule == "evenodd"
        source = -1
        if self.keeps_sources:
            source = len(self.sources)
            self.sources.append(Source(element, original, path, place.map3))
        if isinstance(fill, tuple) and not isinstance(fill, (LinearGradient, RadialGradient)):
            box = np.concatenate(contours)
            if not is_clipped(place.clip, box):
                place.sink.add_polygon(contours, fill, evenodd, source)
                return
        region = filled(contours, evenodd, self._page.budget)
        self.add_region(element, region, fill, place, source)

    def _stroke(
        self, element: Element, path: FlatPath, style: Style, place: Place, opacity: float
    ) -> None:
        if style.stroke is None or style.stroke_width <= 0 or len(path.points) == 0:
            return
        color = self.resolved(
            element, "stroke", style.stroke, style, style.stroke_opacity * opacity, path, place
        )
        if color is None:
            return
        points, map3, scale = path.points, place.map3, place.scale
        if style.vector_effect == "non-scaling-stroke":
            # The outline is made in pixels, whatever the element's own units are. Chromium too
            # ignores the size at which the whole drawing is shown.
            scale, points, map3 = 1.0, affine_maps.apply(map3, points), affine_maps.identity()
        outlines = self._outlines(element, path, points, style, scale)
        if not outlines:
            return
        if isinstance(color, tuple) and not isinstance(color, (LinearGradient, RadialGradient)):
            reach = style.stroke_width / 2 * scale * max(style.stroke_miterlimit, 1.5)
            corners = affine_maps.apply(map3, points)
            if not is_clipped(place.clip, corners, reach):
                place.sink.add_strokes(outlines, map3, color)
                return
        region = stroked(outlines, map3, self._page.budget)
        self.add_region(element, region, color, place, -1)

    def _outlines(
        self, element: Element, path: FlatPath, points: np.ndarray, style: Style, scale: float
    ) -> list[Outline]:
        outlines = []
        contours, closed_contours = path.contours(points), path.closed.tolist()
        chains = zip(contours, path.contours(path.smooth), closed_contours, strict=True)
        pattern, offset = style.stroke_dasharray, style.stroke_dashoffset
        if pattern and "pathLength" in element.attrib:
            pattern, offset = self._scaled_dashes(element, contours, closed_contours, style)
        for chain, smooth, closed in chains:
            if len(chain) == 1 and not closed:
                # A lone `M` draws nothing; a segment of zero length has two points and is a dot.
                continue
            pieces = [(chain, smooth, closed)]
            if pattern and len(chain) > 1:
                cut = dashes(chain, smooth, closed, pattern, offset, self._page.budget)
                pieces = [(part, is_smooth, False) for part, is_smooth in cut]
            outlines += [
                Outline(
                    part, is_closed, style.stroke_width, style.stroke_linecap,
                    style.stroke_linejoin, style.stroke_miterlimit, scale, is_smooth,
                )
                for part, is_smooth, is_closed in pieces
            ]  # fmt: skip
        return outlines

    def _scaled_dashes(
        self, element: Element, contours: list[np.ndarray], closed: list[bool], style: Style
    ) -> tuple[tuple[float, ...], float]:
        """The dash pattern and its offset, in units of which the path has `pathLength`.

        **Source:** SVG 2, section 9.6.1.
        """
        pattern, offset = style.stroke_dasharray, style.stroke_dashoffset
        report = self._page.report(element)
        try:
            stated = finite(element.attrib["pathLength"])
        except ValueError:
            report(INVALID, "pathLength", "is not a finite number")
            return pattern, offset
        if stated <= 0:
            report(INVALID, "pathLength", "must be positive")
            return pattern, offset
        total = 0.0
        for contour, is_closed in zip(contours, closed, strict=True):
            chain = np.concatenate([contour, contour[:1]]) if is_closed else contour
            total += float(np.hypot(*np.diff(chain, axis=0).T).sum())
        factor = total / stated
        if not 0 < factor * sum(pattern) < math.inf:
            return (), 0.0
        return tuple(factor * length for length in pattern), factor * offset

    def add_region(
        self, element: Element, region: Any, fill: Fill, place: Place, source: int
    ) -> None:
        """Clip a region in pixels, divide it into paints, and pass it on."""
        if place.clip is not None:
            region = intersection(region, place.clip, self._page.budget)
        if is_empty(region) or fill is None:
            return
        low_x, low_y, high_x, high_y = map(float, shapely.bounds(region))
        bounds = (low_x, low_y, high_x, high_y)
        if isinstance(fill, LinearGradient):
            pieces = linear_pieces(fill, bounds, self._page.budget)
        elif isinstance(fill, RadialGradient):
            pieces = radial_pieces(fill, bounds, self._page.tolerance, self._page.budget)
        else:
            place.sink.add_items([Item(region, flat(fill), source)])
            return
        place.sink.add_items(self._cut(region, pieces, source))

    def _cut(self, region: Any, pieces: list, source: int) -> list[Item]:
        """Intersect a region with convex pieces."""
        pieces = [piece for piece in pieces if piece.paint.color[3].any()]
        if len(pieces) == 1:
            return [Item(region, pieces[0].paint, source)]
        polygons: Any = np.array([shapely.Polygon(piece.points) for piece in pieces], object)
        shapely.prepare(region)
        meets = shapely.intersects(region, polygons)
        inside = meets & shapely.contains_properly(region, polygons)
        crossing = np.flatnonzero(meets & ~inside)
        # The vertices near each piece are not known; GEOS clips in time of the whole region.
        size = int(shapely.get_num_coordinates(region))
        self._page.budget.charge("overlays", size * len(crossing) // 8)
        polygons[crossing] = shapely.intersection(polygons[crossing], region)
        return [
            Item(polygons_of(polygons[k]), pieces[k].paint, source)
            for k in np.flatnonzero(meets).tolist()
            if not is_empty(polygons[k])
        ]

    def resolved(
        self, element: Element, name: str, paint: Any, style: Style, opacity: float,
        path: FlatPath, place: Place,
    ) -> Fill:  # fmt: skip
        """What a paint paints on a shape: a colour, a gradient, or None."""
        opacity = opacity if self._page.context.opacity else 1.0
        if isinstance(paint, PaintServer):
            server = self._page.target(paint.reference)
            report = self._page.report(element)
            if server is not None and server.name in GRADIENTS:
                fill = gradient_fill(self._page, server, _bounds(path), place.map3, opacity)
                if not isinstance(fill, bool):
                    return fill
            elif server is not None and server.name == "pattern":
                report(WITHOUT_EFFECT, name, "patterns are not drawn")
            elif paint.fallback is False:
                report(INVALID, name, f"refers to no paint ({paint.reference[:40]!r})")
            paint = None if paint.fallback is False else paint.fallback
        paint = style.color if paint == CURRENT else paint
        if paint is None:
            return None
        red, green, blue, alpha = paint
        # A fill of opacity 0 is kept, as a scene may hold triangles that will become visible.
        if alpha == 0 or (name == "stroke" and self._page.context.opacity and opacity == 0):
            return None
        return red, green, blue, alpha * opacity if self._page.context.opacity else 1.0


def _bounds(path: FlatPath) -> Box | None:
    """The bounding box of the fill, in user units."""
    if len(path.points) == 0:
        return None
    low, high = path.points.min(axis=0).tolist(), path.points.max(axis=0).tolist()
    return Box(low[0], low[1], high[0] - low[0], high[1] - low[1])


def is_clipped(clip: Any, points: np.ndarray, margin: float = 0.0) -> bool:
    """Whether a clip may cut something within `margin` of points."""
    if clip is None:
        return False
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    return not bool(shapely.covers(clip, shapely.box(*low, *high)))
