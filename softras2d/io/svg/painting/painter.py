"""Fills and strokes paths: flattens them, resolves their paints, and adds the shapes to a sink.

A shape of one colour that is not clipped stays a set of contours or outlines, which the display
list triangulates many at a time. A shape that is clipped or has a gradient becomes shapely regions.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import shapely

from ....geometry import affine_maps
from ...shapes.dashes import dashes
from ...shapes.outlines import Outline
from ...shapes.paths import FlatPath, Path, flatten
from ...shapes.regions import filled, intersection, is_empty, polygons_of
from ..canvas.layers import Item
from ..canvas.paint import constant_paint
from ..canvas.placement import Placement
from ..canvas.sinks import stroked
from ..css.style import PaintServer, Style
from ..elements.page import Page
from ..elements.view_box import Box
from ..values.css_color import CURRENT, Rgba
from ..values.numbers import finite
from ..xml.notices import INVALID, WITHOUT_EFFECT
from ..xml.tree import Element
from .gradient_pieces import Gradient, LinearGradient, linear_pieces
from .paint_servers import GRADIENTS, Fill, gradient_fill, pattern_applies
from .radial_pieces import radial_pieces


class FillSource(NamedTuple):
    """A filled shape, as `control_points.py` needs it to map control points to vertices.

    - `element`: the shape element.
    - `path`: the path of the element, in user units.
    - `flat_path`: `path`, flattened to polygons.
    - `map3`: homogeneous map `[3, 3]` from the shape's user units to pixels.
    - `is_from_attribute`: whether the path is written in an attribute, instead of in the CSS
      property `d`.
    """

    element: Element
    path: Path
    flat_path: FlatPath
    map3: np.ndarray
    is_from_attribute: bool


class Painter:
    """Paints the shapes of a page.

    - `keeps_sources`: whether filled shapes are stored in `sources`; False at first.
    - `sources`: the shapes that have been filled, in draw order; empty unless `keeps_sources`.
    """

    def __init__(self, page: Page):
        self._page = page
        self.sources: list[FillSource] = []
        self.keeps_sources = False

    def paint(
        self, element: Element, path: Path, style: Style, placement: Placement, opacity: float
    ) -> None:
        """Fill and stroke a path in the order of its `paint-order`, and add both to the sink.

        - `element`: the element that is drawn, which notices name.
        - `path`: in the user units of `element`.
        - `style`: computed style of `element`.
        - `placement`: map to pixels, clip, and sink of the shapes.
        - `opacity`: factor of the alpha of fill and stroke, in 0..1.

        Nothing is painted unless `visibility` is `visible`. Raises `ValueError` for points that the
        map sends to infinity or beyond (w <= 0), for a gradient under a map in perspective, for a
        stroke with a clip or gradient whose coordinates are not finite in float32, and for work
        beyond the budget.
        """
        if style.visibility != "visible":
            return
        linear = placement.map3[:2, :2] / (placement.map3[2, 2] or 1.0)
        flat_path = flatten(path, linear, self._page.tolerance, self._page.budget)
        for kind in style.paint_order:
            if kind == "fill":
                self._fill(element, path, flat_path, style, placement, opacity)
            else:
                self._stroke(element, flat_path, style, placement, opacity)

    def _fill(
        self, element: Element, path: Path, flat_path: FlatPath, style: Style,
        placement: Placement, opacity: float,
    ) -> None:  # fmt: skip
        """Fill a path, if its style has a fill, and add the fill to the sink, clipped.

        `flat_path` is `path`, flattened to polygons. The other arguments are as for `paint`.
        Contours of fewer than three points are not filled, and a `line` never is. If sources are
        kept, what is filled is appended to `sources`.
        """
        if style.fill is None or element.name == "line" or len(flat_path.points) < 3:
            return
        fill = self._resolved(
            element, "fill", style.fill, style, style.fill_opacity * opacity, flat_path, placement
        )
        if fill is None:
            return
        points = affine_maps.apply(placement.map3, flat_path.points)
        contours = [contour for contour in flat_path.contours(points) if len(contour) > 2]
        if not contours:
            return
        evenodd = style.fill_rule == "evenodd"
        source = -1
        if self.keeps_sources:
            source = len(self.sources)
            is_from_attribute = "d" not in self._page.declared(element).css
            self.sources.append(
                FillSource(element, path, flat_path, placement.map3, is_from_attribute)
            )
        clips = placement.clip is not None and placement.may_clip(np.concatenate(contours))
        if not isinstance(fill, Gradient) and not clips:
            placement.sink.add_polygon(contours, fill, evenodd, source)
            return
        region = filled(contours, evenodd, self._page.budget)
        self._add_region(region, fill, placement, source)

    def _stroke(
        self,
        element: Element,
        flat_path: FlatPath,
        style: Style,
        placement: Placement,
        opacity: float,
    ) -> None:
        """Stroke a path, if its style has a stroke, and add the stroke to the sink, clipped.

        `flat_path` is the path, flattened to polygons. The other arguments are as for `paint`. A
        stroke of width 0 is not drawn.
        """
        if style.stroke is None or style.stroke_width <= 0 or len(flat_path.points) == 0:
            return
        paint = self._resolved(
            element,
            "stroke",
            style.stroke,
            style,
            style.stroke_opacity * opacity,
            flat_path,
            placement,
        )
        if paint is None:
            return
        points, map3, scale = flat_path.points, placement.map3, placement.scale
        if style.vector_effect == "non-scaling-stroke":
            # The width is in pixels of the canvas, at whatever size the drawing is shown, as in
            # Chromium.
            scale, points, map3 = 1.0, affine_maps.apply(map3, points), affine_maps.identity()
        outlines = self._outlines(element, flat_path, points, style, scale)
        if not outlines:
            return
        corners = affine_maps.apply(map3, points)
        if not isinstance(paint, Gradient) and not placement.may_clip(corners, outlines[0].reach):
            placement.sink.add_strokes(outlines, map3, paint)
            return
        region = stroked(outlines, map3, self._page.budget)
        self._add_region(region, paint, placement, -1)

    def _outlines(
        self, element: Element, flat_path: FlatPath, points: np.ndarray, style: Style, scale: float
    ) -> list[Outline]:
        """The outlines to stroke for a path: one for each contour, or one for each dash.

        - `flat_path`, `points`: the flattened path, and its points in user units or, for a stroke
          that does not scale, in pixels. The outlines are in the units of `points`.
        - `style`: gives the properties of the stroke, and the dashes, in the same units.
        - `scale`: pixels per unit of `points`.

        A contour of a single point has no outline unless it is closed.
        """
        outlines = []
        contours, closed_contours = flat_path.contours(points), flat_path.closed.tolist()
        chains = zip(contours, flat_path.contours(flat_path.smooth), closed_contours, strict=True)
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
                pieces = [(dash, is_smooth, False) for dash, is_smooth in cut]
            outlines += [
                Outline(
                    line, is_closed, style.stroke_width, style.stroke_linecap,
                    style.stroke_linejoin, style.stroke_miterlimit, scale, is_smooth,
                )
                for line, is_smooth, is_closed in pieces
            ]  # fmt: skip
        return outlines

    def _scaled_dashes(
        self, element: Element, contours: list[np.ndarray], closed: list[bool], style: Style
    ) -> tuple[tuple[float, ...], float]:
        """The dash pattern and its offset, scaled as the attribute `pathLength` asks.

        - `element`: the element of the path, which must have the attribute `pathLength`.
        - `contours`: `[n, 2]` each, the flattened path, in user units or in pixels.
        - `closed`: whether each contour is closed.

        The pattern and offset of `style` are in units in which the complete path is `pathLength`
        long. They are converted to the units of `contours`. The pattern is empty for a stroke
        without gaps: if `pathLength` or the path's length is 0. An invalid `pathLength` is noted
        and has no effect.

        **Source:** SVG 2, section 9.6.1.
        """
        pattern, offset = style.stroke_dasharray, style.stroke_dashoffset
        report = self._page.report(element)
        try:
            stated = finite(element.attrib["pathLength"].strip())
        except ValueError:
            report(INVALID, "pathLength", "is not a finite number")
            return pattern, offset
        if stated < 0:
            report(INVALID, "pathLength", "must not be negative")
            return pattern, offset
        if stated == 0:
            # Every length is scaled to infinity: the path is one dash.
            return (), 0.0
        total = 0.0
        for contour, is_closed in zip(contours, closed, strict=True):
            chain = np.concatenate([contour, contour[:1]]) if is_closed else contour
            total += float(np.hypot(*np.diff(chain, axis=0).T).sum())
        factor = total / stated
        if not 0 < factor * sum(pattern) < math.inf:
            return (), 0.0
        return tuple(factor * length for length in pattern), factor * offset

    def _add_region(
        self, region: Any, fill: Rgba | Gradient, placement: Placement, source: int
    ) -> None:
        """Clip a region in pixels, divide it if it has a gradient, and add it to the sink.

        - `region`: a shapely (multi)polygon. Nothing is added if no area of it is left.
        - `fill`: its colour or gradient.
        - `placement`: has the clip and the sink; the region is not mapped.
        - `source`: index of its shape in `sources`; -1 for none.
        """
        if placement.clip is not None:
            region = intersection(region, placement.clip, self._page.budget)
        if is_empty(region):
            return
        if not isinstance(fill, Gradient):
            placement.sink.add_items([Item(region, constant_paint(fill), source)])
            return
        low_x, low_y, high_x, high_y = map(float, shapely.bounds(region))
        bounds = (low_x, low_y, high_x, high_y)
        if isinstance(fill, LinearGradient):
            pieces = linear_pieces(fill, bounds, self._page.budget)
        else:
            pieces = radial_pieces(fill, bounds, self._page.tolerance, self._page.budget)
        placement.sink.add_items(self._intersect_with_pieces(region, pieces, source))

    def _intersect_with_pieces(self, region: Any, pieces: list, source: int) -> list[Item]:
        """Intersect a region with the pieces of a gradient that cover its bounding box.

        `pieces` is a list of `Piece`, polygons with paints. Returns one item for each piece that
        the region overlaps. Pieces that are fully transparent are left out. A region that a single
        piece covers is not cut. `source` is the index of the region's shape in `sources`; -1 for
        none.
        """
        pieces = [piece for piece in pieces if piece.paint.color[3].any()]
        polygons: Any = np.array([shapely.Polygon(piece.points) for piece in pieces], object)
        if len(pieces) == 1 and shapely.covers(polygons[0], region):
            return [Item(region, pieces[0].paint, source)]
        shapely.prepare(region)
        meets = shapely.intersects(region, polygons)
        inside = meets & shapely.contains_properly(region, polygons)
        crossing = np.flatnonzero(meets & ~inside)
        # GEOS takes time proportional to the whole region for each piece.
        size = int(shapely.get_num_coordinates(region))
        self._page.budget.charge("overlays", size * len(crossing) // 8)
        polygons[crossing] = shapely.intersection(polygons[crossing], region)
        return [
            Item(polygons_of(polygons[k]), pieces[k].paint, source)
            for k in np.flatnonzero(meets).tolist()
            if not is_empty(polygons[k])
        ]

    def _resolved(
        self, element: Element, name: str, paint: Any, style: Style, opacity: float,
        flat_path: FlatPath, placement: Placement,
    ) -> Fill:  # fmt: skip
        """Resolve the paint of a shape's fill or stroke to a colour or a gradient.

        - `name`: `fill` or `stroke`.
        - `paint`: value of this property, a `style.Paint`.
        - `opacity`: factor of the alpha, in 0..1.
        - `flat_path`: the flattened shape, whose bounding box a gradient may need.
        - `placement`: has the map to pixels.

        If the reader does not apply opacities, `opacity` is ignored and the paint is opaque.
        Returns None if nothing is painted, for example for a colour of alpha 0 or a stroke of
        opacity 0. The fallback of a reference is used if its gradient is relative to a box without
        area, and for everything that is no gradient. A reference to a pattern is noted, unless the
        pattern does not apply. A reference to something that is no paint is noted if it has no
        fallback.
        """
        opacity = opacity if self._page.context.opacity else 1.0
        if isinstance(paint, PaintServer):
            server = self._page.target(paint.reference)
            report = self._page.report(element)
            if server is not None and server.name in GRADIENTS:
                fill = gradient_fill(
                    self._page, server, _bounds(flat_path), placement.map3, opacity
                )
                if fill is not False:
                    return fill
            elif server is not None and server.name == "pattern":
                if pattern_applies(server, _bounds(flat_path)):
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


def paints_both(style: Style) -> bool:
    """Whether a shape of this style may have both a fill and a stroke of positive width."""
    return style.fill is not None and style.stroke is not None and style.stroke_width > 0


def _bounds(flat_path: FlatPath) -> Box:
    """The bounding box, in user units, of a path with at least one point, without its stroke."""
    low, high = flat_path.points.min(axis=0).tolist(), flat_path.points.max(axis=0).tolist()
    return Box(low[0], low[1], high[0] - low[0], high[1] - low[1])
