"""Clips triangles against the near plane in homogeneous clip space, before the division by w."""

from typing import NamedTuple

import numpy as np


class ClippedTriangles(NamedTuple):
    """The triangles that remain when triangles are clipped against the near plane.

    - `vertices`: `[vertices, 4]`, (x, y, z, w) in clip space.
    - `triangles`: `[triangles, 3]`, indices of vertices.
    - `source`: `[triangles]`, index of the input triangle of which each triangle is a part.
    - `inside`, `outside`, `t`: `[triangles, 3]`, position of each corner on the input triangle. It
      lies at the fraction `t` of the way from corner `inside` (0, 1 or 2) to corner `outside` of
      the input triangle. For a corner of the input triangle itself, `inside` and `outside` are this
      corner, and `t` is 0.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    source: np.ndarray
    inside: np.ndarray
    outside: np.ndarray
    t: np.ndarray

    def interpolate(self, values: np.ndarray) -> np.ndarray:
        """Interpolate attributes of the input triangles for the clipped triangles.

        `values` are `[triangles, 1 or 3, channels]`: one value per input triangle, or one per
        corner. Returns one value per clipped triangle, or one per corner, as float32.
        """
        if values.shape[1] == 1:
            return values[self.source].astype(np.float32)
        rows = self.source[:, None]
        inside, outside = values[rows, self.inside], values[rows, self.outside]
        return (inside + self.t[..., None] * (outside - inside)).astype(np.float32)


_FAN = np.array([[0, 1, 2], [0, 2, 3]])
"""Vertex indices of the triangles into which a polygon is cut. A polygon of four vertices becomes
both triangles, and a polygon of three vertices only the first."""


def clip_near(vertices: np.ndarray, triangles: np.ndarray) -> ClippedTriangles:
    """Clip triangles against the near plane, and keep the parts where z >= 0.

    `vertices` are `[vertices, 4]` in clip space, where the near plane is z = 0, and `triangles`
    `[triangles, 3]` vertex indices. A triangle may reach behind the viewer, because edges stay
    straight across w = 0 in homogeneous coordinates. Each triangle becomes none, one or two
    triangles, in the same order. A corner whose z is NaN is kept. Vertices without triangles are
    dropped. Triangles that share an edge share its new vertex too.

    **Source:** Sutherland and Hodgman, *Reentrant polygon clipping* (1974); Blinn and Newell,
    *Clipping using homogeneous coordinates* (1978).
    """
    z = vertices[triangles, 2]
    # NaN, the result of an overflow, counts as inside; `world_to_screen` reports it after the
    # division by w.
    crosses = np.sign(z) * np.sign(np.roll(z, -1, axis=1)) < 0
    # The clipped polygon has up to six candidates, in order around the triangle: corner 0, the
    # intersection of edge 01 with the plane, corner 1, ... A corner on the plane is inside and
    # makes no intersection, so a triangle that touches the plane from outside has fewer than three.
    is_candidate = np.stack([~(z < 0), crosses], axis=-1).reshape(-1, 6)
    polygon = np.argsort(~is_candidate, axis=1, kind="stable")[:, :4]
    source, fan_index = np.nonzero(is_candidate.sum(axis=1)[:, None] >= [3, 4])
    candidate = polygon[source[:, None], _FAN[fan_index]]
    rows = source[:, None]
    start, end = candidate // 2, (candidate + 1) // 2 % 3
    # Intersections are computed from the inside end of an edge, so that two triangles that share
    # the edge get the same floats.
    swap = z[rows, start] < 0
    inside, outside = np.where(swap, end, start), np.where(swap, start, end)
    # The result has the vertices that are inside, in their order, and then one new vertex for each
    # edge that crosses the plane.
    count = max(1, len(vertices))
    tail, head = triangles[rows, inside].astype(np.int64), triangles[rows, outside]
    key = np.where(inside == outside, tail, (1 + tail) * count + head)
    key, corners = np.unique(key, return_inverse=True)
    is_cut = key >= count
    tail, head = (vertices[np.where(is_cut, end, key)] for end in np.divmod(key - count, count))
    z_span = np.where(is_cut, tail[:, 2] - head[:, 2], 1.0)
    t = np.where(is_cut, tail[:, 2] / z_span, 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        points = tail + t[:, None] * (head - tail)
    points[is_cut, 2] = 0.0
    corners = corners.reshape(-1, 3)
    return ClippedTriangles(points, corners, source, inside, outside, t[corners])
