"""Collects the shapes of a drawing in order, and triangulates all of them at the end.

Shapes of one kind are triangulated together, which is much faster than one by one. The index of a
shape in draw order is called its **draw**. Sorting triangles by draw restores the order between
kinds.

The *course* is a rasterizer course whose subset of SVG is the dialect `"course"`. Its polygons and
lines are triangulated by its own rules.
"""

from typing import Any

import numpy as np
import shapely

from ...budget import Budget, BudgetError
from ...shapes.ear_clipping import clip_ears, crosses_itself, fill_nonzero
from ...shapes.outlines import Outline
from ...shapes.pixel_lines import pixel_lines
from ...shapes.polygons import fan, fan_inside, fill_regions, triangulate
from ...shapes.strokes import stroke, union
from ..values.css_color import Rgba
from .paint import Paint
from .shape_table import ShapeTable
from .triangles import Batch, Triangles, in_draw_order


class DisplayList:
    """The shapes of a drawing, in draw order.

    Colours are sRGB with straight alpha. Every `add_...` method charges its shape to the budget,
    and raises `BudgetError` if a limit is exceeded.

    - `name`: name of the document, for errors.
    - `budget`: limits the work; None for a new one.
    - `line`: line number of the element that is being read, which the reader of the document sets.
      It is stored with each shape, so that errors of `finish` can name it.
    - `approximated`: number of polygons of `add_ears` that cross or touch themselves, and that
      `finish` filled by the nonzero rule, since they have too many points for ear clipping.
    """

    def __init__(self, name: str, budget: Budget | None = None):
        self.name = name
        self.budget = budget or Budget()
        self.line = 0
        self.approximated = 0
        self._shapes = ShapeTable(name)
        # By draw: the index of the shape's texture.
        self._textures: dict[int, int] = {}
        # By kind of shape: the draws and their geometry.
        self._triangles: list[tuple[int, np.ndarray, np.ndarray | None]] = []
        self._polygons: list[tuple[int, np.ndarray | list[np.ndarray], bool]] = []
        self._regions: list[tuple[int, Any, Paint]] = []
        self._ears: list[tuple[int, np.ndarray, np.ndarray]] = []
        self._strokes: list[tuple[int, Outline, np.ndarray]] = []
        self._hairlines: list[tuple[int, np.ndarray]] = []
        self._pixels: list[tuple[np.ndarray, np.ndarray]] = []

    def __len__(self) -> int:
        """Number of shapes that have been added."""
        return len(self._shapes)

    def add_triangles(self, corners: np.ndarray, color: Rgba | np.ndarray) -> None:
        """Add triangles `[k, 3, 2]` in pixels as one shape.

        They are drawn in their order, so translucent ones are blended twice where they overlap.
        `color` is sRGB with straight alpha: the one colour of all triangles, or an array `[3, 4]`,
        of which row i is the colour of corner i of every triangle.
        """
        self.budget.charge("triangles", len(corners))
        self._triangles.append((self._shapes.add(self.line, color), corners, None))

    def add_textured(
        self, points: np.ndarray, color: Rgba, uv: np.ndarray, texture: int, translucent: bool
    ) -> None:
        """Add a convex polygon with a texture.

        - `points`, `uv`: `[n, 2]`, its corners in pixels, and their texture coordinates (u right, v
          down, 0..1 across the texture).
        - `color`: factor of the texture's colours and alpha, which are sRGB with straight alpha.
        - `texture`: index in `Assets.textures`.
        - `translucent`: whether the polygon is translucent anywhere. If so, the edges between its
          triangles are moved away from samples, since a sample on such an edge is blended twice.
        """
        cut = fan_inside if translucent and len(points) > 3 else fan
        triangles = cut(np.concatenate([points, uv], axis=1)[None])[0]
        self.budget.charge("triangles", len(triangles))
        draw = self._shapes.add(self.line, color)
        self._textures[draw] = texture
        self._triangles.append((draw, triangles[..., :2], triangles[..., 2:]))

    def add_polygon(
        self, points: np.ndarray | list[np.ndarray], color: Rgba, evenodd: bool = False
    ) -> int:
        """Add the inside of one closed contour, or of several that form one shape.

        - `points`: vertices `[n, 2]` in pixels, or a list of such arrays. An edge from the last
          vertex to the first is implied.
        - `color`: the one colour of the shape, sRGB with straight alpha.
        - `evenodd`: whether the fill rule is the even-odd rule instead of the nonzero rule.

        Returns the index of the shape in draw order.
        """
        contours = [points] if isinstance(points, np.ndarray) else points
        self.budget.charge("points", sum(map(len, contours)))
        self._polygons.append((self._shapes.add(self.line, color), points, evenodd))
        return len(self) - 1

    def add_region(self, region: Any, paint: Paint) -> int:
        """Add a shapely (multi)polygon in pixels, filled with a paint.

        Returns the index of the shape in draw order.
        """
        self.budget.charge("points", int(shapely.get_num_coordinates(region)))
        draw = self._shapes.add(self.line, tuple(paint.color[:, 2]))
        if paint.texture >= 0:
            self._textures[draw] = paint.texture
        self._regions.append((draw, region, paint))
        return draw

    def add_ears(self, plane: np.ndarray, points: np.ndarray, color: Rgba) -> None:
        """Add a polygon that `finish` triangulates by the course's ear clipping (`clip_ears`).

        - `plane`: `[n, 2]`, float32, its vertices in user units, from which ears are chosen.
        - `points`: `[n, 2]`, the same vertices in pixels, which become corners of the triangles.
        - `color`: the one colour of the polygon, sRGB with straight alpha.

        A polygon of too many vertices for ear clipping is filled by the nonzero rule instead.
        """
        self.budget.charge("points", len(points))
        self._ears.append((self._shapes.add(self.line, color), plane, points))

    def add_stroke(self, outline: Outline | list[Outline], map3: np.ndarray, color: Rgba) -> None:
        """Add a stroke, which is triangulated in the outline's units and then mapped to pixels.

        - `outline`: one chain of segments, or several that form one shape. A translucent shape is
          blended once where its outlines overlap.
        - `map3`: homogeneous map `[3, 3]` from the outline's units to pixels.
        - `color`: the one colour of the shape, sRGB with straight alpha.
        """
        outlines = [outline] if isinstance(outline, Outline) else outline
        draw = self._shapes.add(self.line, color)
        for chain in outlines:
            self.budget.charge("points", len(chain.points))
            self._strokes.append((draw, chain, map3))

    def add_hairlines(self, segments: np.ndarray, color: Rgba) -> None:
        """Add lines one pixel wide as one shape; `pixel_lines` says which pixels they cover.

        `segments` is `[k, 4]`: (x0, y0, x1, y1) in pixels. `color` is the colour of all lines, sRGB
        with straight alpha. Each line is drawn over the ones before it, so translucent lines are
        blended twice where they cross.
        """
        self.budget.charge("points", len(segments))
        self._hairlines.append((self._shapes.add(self.line, color), segments))

    def add_pixels(self, rectangles: np.ndarray, colors: np.ndarray) -> None:
        """Add rectangles of whole pixels, each as a separate shape.

        - `rectangles`: `[k, 4]`, (x0, y0, x1, y1) in pixels, where x1 and y1 are exclusive.
        - `colors`: `[k, 4]`, the colour of each rectangle, sRGB with straight alpha.
        """
        # The number of triangles that `_rectangles` will make.
        self.budget.charge("triangles", int(np.where(colors[:, 3] < 1, 4, 2).sum()))
        first = len(self)
        self._shapes.add_all(self.line, colors)
        self._pixels.append((np.arange(first, len(self)), rectangles))

    def finish(self, height: int, width: int) -> Triangles:
        """Triangulate all shapes; returns their triangles in draw order.

        `height` and `width` are the size of the canvas in pixels. The lines of `add_hairlines` are
        drawn only on the canvas; other shapes are not cut at its border.

        Adds to `approximated`. Raises `ValueError` for coordinates, texture coordinates and colours
        that are not finite in float32, for a stroke that its map sends to infinity or beyond
        (w <= 0), and for work beyond the budget.
        """
        batches = [
            Batch(np.zeros(0, np.int64), np.zeros((0, 3, 2), np.float32)),
            self._from_triangles(),
            self._from_polygons(),
            self._from_regions(),
            self._from_ears(),
            self._from_strokes(),
            self._from_hairlines(height, width),
            self._from_pixels(),
        ]
        batches = [batch for batch in batches if batch is not None]
        texture = np.full(len(self), -1)
        if self._textures:
            texture[list(self._textures)] = list(self._textures.values())
        return in_draw_order(batches, self._shapes.color_table(), texture)

    def _batch(self, draw: np.ndarray, corners: np.ndarray) -> Batch:
        """Make a batch of triangles without texture that have the colours of their shapes.

        - `draw`: `[t]`, the index in draw order of the shape of each triangle.
        - `corners`: `[t, 3, 2]` in pixels, which are rounded to float32.

        Raises `SvgError` if a rounded corner is not finite.
        """
        return Batch(draw, self._shapes.float32(corners, draw))

    def _from_triangles(self) -> Batch | None:
        """Collect the shapes of `add_triangles` and `add_textured`; None if there are none."""
        if not self._triangles:
            return None
        draw, corners, uvs = zip(*self._triangles, strict=True)
        batch = self._batch(np.repeat(draw, list(map(len, corners))), np.concatenate(corners))
        if not self._textures:
            return batch
        uvs = [np.zeros_like(c) if uv is None else uv for uv, c in zip(uvs, corners, strict=True)]
        return batch._replace(
            uv=self._shapes.float32(np.concatenate(uvs), batch.draw, "a texture coordinate")
        )

    def _from_polygons(self) -> Batch | None:
        """Triangulate the shapes from `add_polygon`; None if there are none.

        Raises `SvgError`, with the line of a shape, for coordinates that are not finite in float32
        and for work beyond the budget.
        """
        if not self._polygons:
            return None
        draw, contours, evenodd = zip(*self._polygons, strict=True)
        draw = np.array(draw)
        # Checked first, since GEOS does not handle infinities.
        points = [c if isinstance(c, np.ndarray) else np.concatenate(c) for c in contours]
        self._shapes.float32(np.concatenate(points), np.repeat(draw, list(map(len, points))))
        try:
            corners, owner = triangulate(
                contours, evenodd, self._shapes.is_translucent(draw).tolist(), self.budget
            )
        except BudgetError as error:
            raise self._shapes.error(int(draw[error.index]), f"the polygon {error}") from None
        return self._batch(draw[owner], corners)

    def _from_regions(self) -> Batch | None:
        """Triangulate the shapes from `add_region`; None if there are none.

        Paints give each corner its colour and texture coordinates. Raises `SvgError` for values
        that are not finite in float32, and `BudgetError` for too many triangles.
        """
        if not self._regions:
            return None
        draw, regions, paints = zip(*self._regions, strict=True)
        draw, regions = np.array(draw), np.array(regions, object)
        translucent = np.array([not paint.is_opaque for paint in paints])
        # GEOS does not handle infinities.
        coordinates, region = shapely.get_coordinates(regions, return_index=True)
        self._shapes.float32(coordinates, draw[region])
        corners, owner = fill_regions(regions, translucent, np.arange(len(regions)))
        self.budget.charge("triangles", len(corners))
        batch = self._batch(draw[owner], corners)
        matrices = np.stack([paint.color for paint in paints])
        if matrices[..., :2].any():
            matrix = matrices[owner]
            colors = np.einsum("tij,tcj->tci", matrix[..., :2], corners) + matrix[:, None, :, 2]
            colors[..., 3] = np.clip(colors[..., 3], 0.0, 1.0)
            batch = batch._replace(colors=self._shapes.float32(colors, batch.draw, "a colour"))
        if not self._textures:
            return batch
        maps = np.stack([np.zeros((2, 3)) if p.uv is None else p.uv for p in paints])[owner]
        uv = np.einsum("tij,tcj->tci", maps[..., :2], corners) + maps[:, None, :, 2]
        return batch._replace(uv=self._shapes.float32(uv, batch.draw, "a texture coordinate"))

    def _from_ears(self) -> Batch | None:
        """Triangulate the shapes from `add_ears`; None if there are none.

        Polygons that ear clipping skips are filled by the nonzero rule; those of them that cross or
        touch themselves are counted in `approximated`. Errors are as for `_from_polygons`.
        """
        if not self._ears:
            return None
        draw, planes, contours = zip(*self._ears, strict=True)
        try:
            owner, ears, skipped = clip_ears(planes, self.budget)
        except BudgetError as error:
            raise self._shapes.error(draw[error.index], f"the polygon {error}") from None
        starts = np.cumsum([0, *map(len, contours)])
        corners, owners = [np.concatenate(contours)[starts[owner, None] + ears]], [owner]
        for index in skipped:
            self._shapes.float32(contours[index], np.full(len(contours[index]), draw[index]))
            try:
                self.approximated += crosses_itself(planes[index], self.budget, index)
                corners.append(fill_nonzero(contours[index], self.budget))
            except BudgetError as error:
                raise self._shapes.error(draw[index], f"the polygon {error}") from None
            owners.append(np.full(len(corners[-1]), index))
        return self._batch(np.array(draw)[np.concatenate(owners)], np.concatenate(corners))

    def _from_strokes(self) -> Batch | None:
        """Triangulate the shapes from `add_stroke`; None if there are none.

        The triangles of a translucent stroke do not overlap; those of an opaque one may. Errors are
        as for `_mapped`, and `SvgError` is also raised for work beyond the budget.
        """
        if not self._strokes:
            return None
        draw, outlines, maps = zip(*self._strokes, strict=True)
        draw = np.array(draw)
        try:
            corners, owner = stroke(outlines, self.budget)
        except BudgetError as error:
            raise self._shapes.error(int(draw[error.index]), f"the stroke {error}") from None
        corners = self._mapped(np.array(maps), corners, owner, draw)
        is_translucent = self._shapes.is_translucent(draw)
        is_opaque = ~is_translucent[owner]
        # The triangles of a stroke overlap at joins, where a translucent one would be blended
        # twice.
        translucent_draws, triangle_draws = np.unique(draw[is_translucent]), draw[owner]
        starts = np.searchsorted(triangle_draws, translucent_draws)
        ends = np.searchsorted(triangle_draws, translucent_draws + 1)
        regions = np.empty(len(translucent_draws), object)
        for k, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
            try:
                regions[k] = union(corners[start:end], self.budget)
            except BudgetError as error:
                stroke_draw = int(translucent_draws[k])
                raise self._shapes.error(stroke_draw, f"the translucent stroke {error}") from None
        if len(regions) == 0:
            return self._batch(triangle_draws, corners)
        filled, filled_draws = fill_regions(regions, np.ones(len(regions), bool), translucent_draws)
        return self._batch(
            np.concatenate([triangle_draws[is_opaque], filled_draws]),
            np.concatenate([corners[is_opaque], filled]),
        )

    def _mapped(
        self, maps: np.ndarray, corners: np.ndarray, owner: np.ndarray, draw: np.ndarray
    ) -> np.ndarray:
        """Map triangles of strokes to pixels; returns `[t, 3, 2]` in float64.

        - `maps`: `[outlines, 3, 3]`, homogeneous map of each outline to pixels.
        - `corners`: `[t, 3, 2]`, in the units of the outlines.
        - `owner`: `[t]`, index of the outline of each triangle.
        - `draw`: `[outlines]`, index in draw order of the shape of each outline, for errors.

        Raises `SvgError` for points that are mapped to infinity or beyond (w <= 0), and for results
        that are not finite in float32.
        """
        maps = maps[owner]
        with np.errstate(over="ignore", invalid="ignore"):
            mapped = np.einsum("tij,tcj->tci", maps[..., :2], corners) + maps[:, None, :, 2]
        is_bad = ~(mapped[..., 2] > 0).all(axis=1)
        if is_bad.any():
            message = "`transform` maps a stroke to infinity or beyond (w <= 0)."
            raise self._shapes.error(int(draw[owner[np.argmax(is_bad)]]), message)
        mapped = mapped[..., :2] / mapped[..., 2:]
        self._shapes.float32(mapped, draw[owner])
        return mapped

    def _from_hairlines(self, height: int, width: int) -> Batch | None:
        """Make the triangles of the lines from `add_hairlines`; None if there are no lines.

        `height` and `width` are the size of the canvas in pixels; pixels outside it are left out.
        Errors are as for `_from_polygons`.
        """
        if not self._hairlines:
            return None
        draw, segments = zip(*self._hairlines, strict=True)
        draw = np.repeat(draw, list(map(len, segments)))
        rounded = self._shapes.float32(np.concatenate(segments), draw)
        triangles_each = np.where(self._shapes.is_translucent(draw), 4, 2)
        try:
            rectangles, line = pixel_lines(rounded, height, width, self.budget, triangles_each)
        except BudgetError as error:
            raise self._shapes.error(int(draw[error.index]), f"the line {error}") from None
        return self._rectangles(draw[line], rectangles)

    def _from_pixels(self) -> Batch | None:
        """Triangulate the rectangles from `add_pixels`; None if there are none."""
        if not self._pixels:
            return None
        draw, rectangles = zip(*self._pixels, strict=True)
        return self._rectangles(np.concatenate(draw), np.concatenate(rectangles))

    def _rectangles(self, draw: np.ndarray, rectangles: np.ndarray) -> Batch:
        """Divide rectangles into two triangles each, or four if they are translucent.

        - `draw`: `[k]`, the index in draw order of the shape of each rectangle.
        - `rectangles`: `[k, 4]`, (x0, y0, x1, y1) in pixels, where x1 and y1 are exclusive.

        The triangles are in the order of the rectangles. The docstring of `polygons.py` says why
        translucent rectangles need more triangles.
        """
        x0, y0, x1, y1 = rectangles.astype(np.float64).T
        quads = np.stack([x0, y0, x1, y0, x1, y1, x0, y1], axis=-1).reshape(-1, 4, 2)
        is_translucent = self._shapes.is_translucent(draw)
        corners, owners = [], []
        for chosen, cut in ((~is_translucent, fan), (is_translucent, fan_inside)):
            triangles = cut(quads[chosen])
            corners.append(triangles.reshape(-1, 3, 2))
            owners.append(np.repeat(np.flatnonzero(chosen), triangles.shape[1]))
        # Rectangles of one draw may overlap, so their order must not change.
        owner = np.concatenate(owners)
        order = np.argsort(owner, kind="stable")
        return self._batch(draw[owner[order]], np.concatenate(corners)[order])
