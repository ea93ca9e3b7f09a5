"""What a drawing draws, in order: collected element by element, made into triangles all at once."""

from typing import Any, NamedTuple

import numpy as np

from .pixel_lines import pixel_lines
from .polygons import PolygonError, fan, fan_inside, fill_regions, triangulate
from .svg_document import SvgError
from .svg_style import Rgba


class Triangles(NamedTuple):
    """Triangles back to front. `uv` is zero and `texture` -1 where there is no texture."""

    corners: np.ndarray  # [triangles, 3, 2] float32
    colors: np.ndarray  # [triangles, 3, 4] float64, straight
    uv: np.ndarray  # [triangles, 3, 2] float64
    texture: np.ndarray  # [triangles] int64


class DisplayList:
    """Fills, lines, pixels and triangles in draw order, in pixels, float64.

    Every `add_*` draws over all before it. `line` is kept for errors that show at the end.
    """

    def __init__(self, name: str):
        self.name = name
        self.line = 0
        self._lines: list[int] = []
        self._triangles: list[tuple[int, np.ndarray, np.ndarray, np.ndarray | None, int]] = []
        self._polygons: list[tuple[int, np.ndarray, Rgba, bool]] = []
        self._regions: list[tuple[int, Any, Rgba]] = []
        self._hairlines: list[tuple[int, np.ndarray, Rgba]] = []
        self._pixels: list[tuple[int, np.ndarray, np.ndarray]] = []

    def __len__(self) -> int:
        return len(self._lines)

    def add_triangles(
        self,
        corners: np.ndarray,
        colors: np.ndarray | Rgba,
        uv: np.ndarray | None = None,
        texture: int = -1,
    ) -> None:
        """`corners` `[k, 3, 2]`; `colors` straight RGBA, one or `[k, 3, 4]`."""
        colors = np.broadcast_to(np.asarray(colors, np.float64), (len(corners), 3, 4))
        self._triangles.append((self._next(), corners, colors, uv, texture))

    def add_textured(
        self, points: np.ndarray, color: Rgba, uv: np.ndarray, texture: int, translucent: bool
    ) -> None:
        """A convex polygon `[n, 2]` that shows a texture, `uv` `[n, 2]` at its corners."""
        both = (fan_inside if translucent else fan)(np.concatenate([points, uv], axis=1)[None])[0]
        self.add_triangles(both[..., :2], color, both[..., 2:], texture)

    def add_polygon(self, points: np.ndarray, color: Rgba, evenodd: bool = False) -> None:
        """The inside of a closed contour `[n, 2]`."""
        self._polygons.append((self._next(), points, color, evenodd))

    def add_region(self, region: Any, color: Rgba) -> None:
        """A shapely (multi)polygon."""
        self._regions.append((self._next(), region, color))

    def add_hairlines(self, segments: np.ndarray, color: Rgba) -> None:
        """Lines `[k, 4]` (x0, y0, x1, y1), one pixel wide, each over the one before."""
        self._hairlines.append((self._next(), segments, color))

    def add_pixels(self, rectangles: np.ndarray, colors: np.ndarray | Rgba) -> None:
        """Rectangles `[k, 4]` (x0, y0, x1, y1); straight RGBA, one or `[k, 4]`."""
        colors = np.broadcast_to(np.asarray(colors, np.float64), (len(rectangles), 4))
        self._pixels.append((self._next(), np.asarray(rectangles, np.float64), colors))

    def _next(self) -> int:
        self._lines.append(self.line)
        return len(self._lines) - 1

    def finish(self, height: int, width: int) -> Triangles:
        """All as triangles. Raises `ValueError` for coordinates beyond float32."""
        made = [
            _Batch.empty(),
            self._from_triangles(),
            self._from_polygons(),
            self._from_regions(),
            self._from_hairlines(height, width),
            self._from_pixels(),
        ]
        batch = _Batch(*(np.concatenate(parts) for parts in zip(*made, strict=True)))
        order = np.argsort(batch.order, kind="stable")
        batch = _Batch(*(field[order] for field in batch))
        return Triangles(
            self._float32(batch.corners, batch.order), batch.colors, batch.uv, batch.texture
        )

    def _float32(self, points: np.ndarray, order: np.ndarray) -> np.ndarray:
        """Coordinates `[k, ...]` of the given draws, rounded to float32."""
        with np.errstate(over="ignore"):
            rounded = points.astype(np.float32)
        bad = ~np.isfinite(rounded).all(axis=tuple(range(1, rounded.ndim)))
        if bad.any():
            where = f"{self.name}:{self._lines[order[np.argmax(bad)]]}"
            raise SvgError(f"{where}: a coordinate is not a finite number of pixels in float32.")
        return rounded

    def _from_triangles(self) -> "_Batch":
        if not self._triangles:
            return _Batch.empty()
        order, corners, colors, uv, texture = zip(*self._triangles, strict=True)
        counts = [len(part) for part in corners]
        uv = [np.zeros_like(c) if u is None else u for u, c in zip(uv, corners, strict=True)]
        return _Batch(
            np.repeat(order, counts),
            np.concatenate(corners),
            np.concatenate(colors),
            np.concatenate(uv),
            np.repeat(texture, counts),
        )

    def _from_polygons(self) -> "_Batch":
        if not self._polygons:
            return _Batch.empty()
        order, contours, colors, evenodd = zip(*self._polygons, strict=True)
        # GEOS must see no infinities.
        self._float32(
            np.concatenate(contours), np.repeat(order, [len(points) for points in contours])
        )
        rgba = np.array(colors)
        try:
            corners, index = triangulate(contours, evenodd, (rgba[:, 3] < 1).tolist())
        except PolygonError as error:
            where = f"{self.name}:{self._lines[order[error.index]]}"
            raise SvgError(f"{where}: the polygon {error}") from None
        return _Batch.flat(np.array(order)[index], corners, rgba[index])

    def _from_regions(self) -> "_Batch":
        if not self._regions:
            return _Batch.empty()
        order, regions, colors = zip(*self._regions, strict=True)
        rgba = np.array(colors)
        corners, index = fill_regions(np.array(regions, object), rgba[:, 3] < 1)
        return _Batch.flat(np.array(order)[index], corners, rgba[index])

    def _from_hairlines(self, height: int, width: int) -> "_Batch":
        if not self._hairlines:
            return _Batch.empty()
        order, segments, colors = zip(*self._hairlines, strict=True)
        owner = np.repeat(np.arange(len(order)), [len(part) for part in segments])
        rounded = self._float32(np.concatenate(segments), np.array(order)[owner])
        rectangles, line = pixel_lines(rounded, height, width)
        owner = owner[line]
        return _rectangles(np.array(order)[owner], rectangles, np.array(colors)[owner])

    def _from_pixels(self) -> "_Batch":
        if not self._pixels:
            return _Batch.empty()
        order, rectangles, colors = zip(*self._pixels, strict=True)
        counts = [len(part) for part in rectangles]
        return _rectangles(
            np.repeat(order, counts), np.concatenate(rectangles), np.concatenate(colors)
        )


class _Batch(NamedTuple):
    order: np.ndarray
    corners: np.ndarray
    colors: np.ndarray
    uv: np.ndarray
    texture: np.ndarray

    @staticmethod
    def flat(order: np.ndarray, corners: np.ndarray, rgba: np.ndarray) -> "_Batch":
        """Triangles of one colour each, `[k, 4]`."""
        count = len(corners)
        return _Batch(
            order,
            corners,
            np.broadcast_to(rgba[:, None], (count, 3, 4)),
            np.zeros((count, 3, 2)),
            np.full(count, -1),
        )

    @staticmethod
    def empty() -> "_Batch":
        return _Batch.flat(np.zeros(0, np.int64), np.zeros((0, 3, 2)), np.zeros((0, 4)))


def _rectangles(order: np.ndarray, rectangles: np.ndarray, rgba: np.ndarray) -> _Batch:
    """Two triangles for each opaque rectangle, four for a translucent one (see `polygons`)."""
    x0, y0, x1, y1 = rectangles.astype(np.float64).T
    quads = np.stack(
        [np.stack(pair, axis=-1) for pair in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))], axis=1
    )
    batches = [_Batch.empty()]
    glassy = rgba[:, 3] < 1
    for chosen, fill in ((~glassy, fan), (glassy, fan_inside)):
        triangles = fill(quads[chosen])
        per = triangles.shape[1]
        batches.append(
            _Batch.flat(
                np.repeat(order[chosen], per),
                triangles.reshape(-1, 3, 2),
                np.repeat(rgba[chosen], per, axis=0),
            )
        )
    # Lines of one draw may cross: their order is that of the rectangles.
    place = np.concatenate(
        [np.repeat(np.flatnonzero(~glassy), 2), np.repeat(np.flatnonzero(glassy), 4)]
    )
    merged = _Batch(*(np.concatenate(parts) for parts in zip(*batches, strict=True)))
    arranged = np.argsort(place, kind="stable")
    return _Batch(*(field[arranged] for field in merged))
