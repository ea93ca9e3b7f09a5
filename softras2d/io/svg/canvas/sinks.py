"""Defines what receives painted shapes: a canvas draws them, a layer collects those of a group."""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import shapely

from ....geometry import affine_maps
from ...budget import Budget
from ...shapes.outlines import Outline
from ...shapes.regions import EMPTY, filled, is_empty, polygons_of
from ...shapes.strokes import stroke, union
from ..values.css_color import Rgba
from .display_list import DisplayList
from .layers import Item, disjoint_cells
from .paint import Paint, constant_paint, corner_paint


class Textured(NamedTuple):
    """A convex polygon with a texture.

    - `points`, `uv`: `[n, 2]`, vertices in pixels, and their texture coordinates (u right, v down,
      0..1 across the texture; beyond, its border texels are repeated).
    - `color`: white, with the opacity as its alpha.
    - `texture`: index in `Assets.textures`.
    - `translucent`: whether the texture has an alpha channel, or the opacity is below 1.
    """

    points: np.ndarray
    color: Rgba
    uv: np.ndarray
    texture: int
    translucent: bool


@runtime_checkable
class Sink(Protocol):
    """The interface of objects that receive the shapes of a drawing, in draw order.

    Points are in pixels, unless a map is given. Colours are sRGB with straight alpha.
    """

    def add_polygon(
        self, contours: list[np.ndarray], color: Rgba, evenodd: bool, source: int
    ) -> None:
        """Add the inside of closed contours `[n, 2]` in pixels, which form one shape.

        - `contours`: at least one. An edge from the last vertex of each to its first is implied.
        - `color`: the one colour of the shape, sRGB with straight alpha.
        - `evenodd`: whether the shape is filled by the even-odd rule instead of the nonzero rule.
        - `source`: index of the shape in `Painter.sources`, by which its control points are looked
          up; -1 for none.
        """
        ...

    def add_strokes(self, outlines: list[Outline], map3: np.ndarray, color: Rgba) -> None:
        """Add the strokes of one path.

        - `outlines`: one for each contour or dash of the path, at least one. Where they overlap, a
          translucent stroke is blended once.
        - `map3`: homogeneous map `[3, 3]` from the units of the outlines to pixels.
        - `color`: the one colour of all strokes, sRGB with straight alpha.
        """
        ...

    def add_triangle(self, corners: np.ndarray, colors: np.ndarray) -> None:
        """Add a triangle with a colour for each corner.

        `corners` `[3, 2]` are in pixels, and `colors` `[3, 4]` are sRGB with straight alpha.
        """
        ...

    def add_textured(self, textured: Textured) -> None:
        """Add a polygon with a texture."""
        ...

    def add_items(self, items: list[Item]) -> None:
        """Add regions with paints. The regions must not overlap each other."""
        ...


class Canvas:
    """The sink that adds every shape to the display list as soon as it is received.

    `sources` maps the index of a polygon or region in draw order to its index in `Painter.sources`,
    which may be -1. Other shapes are not in it.
    """

    def __init__(self, display: DisplayList):
        self._display = display
        self.sources: dict[int, int] = {}

    def add_polygon(
        self, contours: list[np.ndarray], color: Rgba, evenodd: bool, source: int
    ) -> None:
        """Draw the inside of contours; the arguments are as for `Sink.add_polygon`."""
        points = contours[0] if len(contours) == 1 else contours
        self.sources[self._display.add_polygon(points, color, evenodd)] = source

    def add_strokes(self, outlines: list[Outline], map3: np.ndarray, color: Rgba) -> None:
        """Draw the strokes of a path; the arguments are as for `Sink.add_strokes`.

        Translucent strokes become one shape of the display list, so that overlaps are blended once.
        Opaque strokes become one shape each.
        """
        if color[3] < 1 and len(outlines) > 1:
            self._display.add_stroke(outlines, map3, color)
            return
        for outline in outlines:
            self._display.add_stroke(outline, map3, color)

    def add_triangle(self, corners: np.ndarray, colors: np.ndarray) -> None:
        """Draw a triangle; the arguments are as for `Sink.add_triangle`."""
        self._display.add_triangles(corners[None], colors)

    def add_textured(self, textured: Textured) -> None:
        """Draw a polygon with a texture."""
        self._display.add_textured(*textured)

    def add_items(self, items: list[Item]) -> None:
        """Draw regions with their paints, each as one shape. The regions must not overlap."""
        for item in items:
            self.sources[self._display.add_region(item.region, item.paint)] = item.source


class _Call(NamedTuple):
    """A shape that a layer has received.

    - `bounds`: bounding box (x0, y0, x1, y1) of the shape in pixels, or a larger box.
    - `replay`: function that adds the shape to a sink, with its alpha multiplied by an opacity.
    - `items`: function that converts the shape to regions with paints, with its alpha unchanged.
    - `family`: number, from 1, of the call of `add_items` that the shape comes from; -1 for a shape
      from another method. Shapes from one call of `add_items` do not overlap.
    """

    bounds: np.ndarray
    replay: Callable[[Sink, float], None]
    items: Callable[[], list[Item]]
    family: int = -1


class Layer:
    """The sink that collects the shapes of a group, which `finish` composites.

    `budget` is charged for the work of `finish`.
    """

    def __init__(self, budget: Budget):
        self._budget = budget
        self._calls: list[_Call] = []
        self._families = 0

    def add_polygon(
        self, contours: list[np.ndarray], color: Rgba, evenodd: bool, source: int
    ) -> None:
        """Collect the inside of contours; the arguments are as for `Sink.add_polygon`."""

        self._calls.append(
            _Call(
                _bounds(np.concatenate(contours)),
                lambda sink, opacity: sink.add_polygon(
                    contours, _with_opacity(color, opacity), evenodd, source
                ),
                lambda: [
                    Item(filled(contours, evenodd, self._budget), constant_paint(color), source)
                ],
            )
        )

    def add_strokes(self, outlines: list[Outline], map3: np.ndarray, color: Rgba) -> None:
        """Collect the strokes of a path; the arguments are as for `Sink.add_strokes`.

        Raises `ValueError` for points that `map3` sends to infinity or beyond (w <= 0).
        """
        reach = max(outline.reach for outline in outlines)
        points = affine_maps.apply(map3, np.concatenate([line.points for line in outlines]))
        bounds = _bounds(points) + reach * np.array([-1.0, -1.0, 1.0, 1.0])

        self._calls.append(
            _Call(
                bounds,
                lambda sink, opacity: sink.add_strokes(
                    outlines, map3, _with_opacity(color, opacity)
                ),
                lambda: [Item(stroked(outlines, map3, self._budget), constant_paint(color))],
            )
        )

    def add_triangle(self, corners: np.ndarray, colors: np.ndarray) -> None:
        """Collect a triangle; the arguments are as for `Sink.add_triangle`."""
        self._calls.append(
            _Call(
                _bounds(corners),
                lambda sink, opacity: sink.add_triangle(corners, colors * [1, 1, 1, opacity]),
                lambda: triangle_items(corners, colors),
            )
        )

    def add_textured(self, textured: Textured) -> None:
        """Collect a polygon with a texture."""
        self._calls.append(
            _Call(
                _bounds(textured.points),
                lambda sink, opacity: sink.add_textured(
                    textured._replace(
                        color=_with_opacity(textured.color, opacity),
                        translucent=textured.translucent or opacity < 1,
                    )
                ),
                lambda: textured_items(textured),
            )
        )

    def add_items(self, items: list[Item]) -> None:
        """Collect regions with their paints. The regions must not overlap each other."""
        self._families += 1
        for item in items:
            item = item._replace(family=self._families)
            self._calls.append(
                _Call(
                    np.array(shapely.bounds(item.region)),
                    lambda sink, opacity, item=item: sink.add_items(
                        [item._replace(paint=item.paint.with_opacity(opacity))]
                    ),
                    lambda item=item: [item],
                    self._families,
                )
            )

    def finish(self, sink: Sink, opacity: float) -> bool:
        """Composite the collected shapes, multiply the result by `opacity`, and add it to `sink`.

        A shape whose bounding box meets no other is passed on unchanged but for its alpha. Shapes
        may be passed on in another order if they do not overlap. Returns whether the colours are
        exact everywhere; they may not be where translucent shapes overlap. Raises `ValueError` for
        coordinates that are not finite, unless a single shape was collected, and for work beyond
        the budget.
        """
        if not self._calls:
            return True
        # Each group passes on all shapes of the groups inside it once more.
        self._budget.charge("overlays", 16 * len(self._calls))
        is_alone = self._is_alone()
        alone: list[Item] = []
        overlapping: list[Item] = []
        for call, is_free in zip(self._calls, is_alone.tolist(), strict=True):
            if is_free and call.family < 0:
                call.replay(sink, opacity)
            else:
                items = [item for item in call.items() if not is_empty(item.region)]
                (alone if is_free else overlapping).extend(items)
        cells, is_exact = disjoint_cells(overlapping, self._budget) if overlapping else ([], True)
        # In one call, since these regions do not overlap: an outer group need not test them again.
        if cells or alone:
            sink.add_items([c._replace(paint=c.paint.with_opacity(opacity)) for c in cells + alone])
        return is_exact

    def _is_alone(self) -> np.ndarray:
        """For each shape `[shapes]`, whether its bounding box meets that of no other shape.

        Shapes from the same call of `add_items` do not count, since they do not overlap. Raises
        `ValueError` if one of several bounding boxes is not finite, and for work beyond the budget.
        """
        if len(self._calls) == 1:
            return np.ones(1, bool)
        bounds = np.stack([call.bounds for call in self._calls])
        if not np.isfinite(bounds).all():
            raise ValueError("a coordinate is not finite in float32.")
        families = np.array([call.family for call in self._calls])
        if (families == families[0]).all() and families[0] >= 0:
            return np.ones(len(families), bool)
        boxes: Any = shapely.box(*bounds.T)
        tree = shapely.STRtree(boxes)
        is_alone = np.ones(len(boxes), bool)
        for start in range(0, len(boxes), 1024):
            shape, neighbour = tree.query(boxes[start : start + 1024])
            self._budget.charge("overlays", len(shape))
            shape = shape + start
            meets = (shape != neighbour) & (
                (families[shape] != families[neighbour]) | (families[shape] < 0)
            )
            is_alone[shape[meets]] = False
        return is_alone


def stroked(outlines: list[Outline], map3: np.ndarray, budget: Budget) -> Any:
    """The shapely region, in pixels, that the strokes of a path cover; it may be empty.

    `map3` is the homogeneous map `[3, 3]` from the units of the outlines to pixels. Raises
    `ValueError` for a corner that it sends to infinity or beyond (w <= 0), for a coordinate that is
    not finite in float32, and for work beyond the budget.
    """
    corners, _ = stroke(outlines, budget)
    if len(corners) == 0:
        return EMPTY
    corners = affine_maps.apply(map3, corners)
    with np.errstate(over="ignore"):
        if not np.isfinite(corners.astype(np.float32)).all():
            raise ValueError("stroke: a coordinate is not finite in float32.")
    return polygons_of(union(corners, budget))


def triangle_items(corners: np.ndarray, colors: np.ndarray) -> list[Item]:
    """Make an item of a triangle with a colour for each corner; returns it in a list.

    `corners` `[3, 2]` are in pixels, and `colors` `[3, 4]` are sRGB with straight alpha. Returns an
    empty list for a triangle with hardly any area (`corner_paint`).
    """
    paint = corner_paint(corners, colors)
    return [] if paint is None else [Item(shapely.Polygon(corners), paint)]


def textured_items(textured: Textured) -> list[Item]:
    """Make an item of a polygon with a texture; returns it in a list.

    The map to texture coordinates is affine. It is computed from the first three vertices, so that
    the texture coordinates of others do not matter. Returns an empty list if the first three
    vertices span hardly any area, less than 5e-13 square pixels.
    """
    points = textured.points
    matrix = np.column_stack([points[:3], np.ones(3)])
    if abs(np.linalg.det(matrix)) < 1e-12:
        return []
    uv = np.linalg.solve(matrix, textured.uv[:3]).T
    paint = Paint(constant_paint(textured.color).color, uv, textured.texture, textured.translucent)
    return [Item(shapely.Polygon(points), paint)]


def _with_opacity(color: Rgba, opacity: float) -> Rgba:
    """Multiply the alpha of a colour by an opacity."""
    return (*color[:3], color[3] * opacity)


def _bounds(points: np.ndarray) -> np.ndarray:
    """The bounding box (x0, y0, x1, y1), an array `[4]`, of points `[n, 2]`."""
    return np.concatenate([points.min(axis=0), points.max(axis=0)])
