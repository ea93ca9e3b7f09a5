"""Triangles in homogeneous clip space, clipped against the near plane before the division by w."""

from typing import NamedTuple

import numpy as np


class Cut(NamedTuple):
    """Triangles beyond the near plane, and where each corner lies in the triangle it came from.

    - `vertices`: `[vertices, 4]` in clip space, `triangles` `[triangles, 3]`.
    - `owner`: `[triangles]`, the triangle that each is a part of.
    - `kept`, `lost`, `t`: `[triangles, 3]`; a corner is at `t` from the owner's corner `kept` to
      its corner `lost`, which are the same where nothing is cut.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    owner: np.ndarray
    kept: np.ndarray
    lost: np.ndarray
    t: np.ndarray

    def carry(self, values: np.ndarray) -> np.ndarray:
        """`[triangles, 1 or 3, channels]` of the owners, at the corners of the parts; float32."""
        if values.shape[1] == 1:
            return values[self.owner].astype(np.float32)
        rows = self.owner[:, None]
        kept, lost = values[rows, self.kept], values[rows, self.lost]
        return (kept + self.t[..., None] * (lost - kept)).astype(np.float32)


_FAN = np.array([[0, 1, 2], [0, 2, 3]])
"""The triangles of a polygon of three or four vertices."""


def cut_near(vertices: np.ndarray, triangles: np.ndarray) -> Cut:
    """Clip against z >= 0, in homogeneous space, where edges are straight on both sides of w = 0.

    **Source:** Sutherland and Hodgman, *Reentrant polygon clipping* (1974); Blinn and Newell,
    *Clipping using homogeneous coordinates* (1978).
    """
    z = vertices[triangles, 2]
    # NaN, of what overflowed, counts as beyond: whoever divides by w sees it.
    crosses = np.sign(z) * np.sign(np.roll(z, -1, axis=1)) < 0
    # Around the triangle: corner 0, the cut of edge 01, corner 1, ... A corner on the plane is
    # kept and makes no cut, so a triangle that only touches it from in front has too few.
    there = np.stack([~(z < 0), crosses], axis=-1).reshape(-1, 6)
    around = np.argsort(~there, axis=1, kind="stable")[:, :4]
    owner, part = np.nonzero(there.sum(axis=1)[:, None] >= [3, 4])
    spot = around[owner[:, None], _FAN[part]]
    rows = owner[:, None]
    start, end = spot // 2, (spot + 1) // 2 % 3
    # From the end that is kept, whichever way round: neighbours compute the same cut.
    swap = z[rows, start] < 0
    kept, lost = np.where(swap, end, start), np.where(swap, start, end)
    # One vertex for each that is kept, in their order, and then one for each edge that is cut.
    count = max(1, len(vertices))
    tail, head = triangles[rows, kept].astype(np.int64), triangles[rows, lost]
    key = np.where(kept == lost, tail, (1 + tail) * count + head)
    key, corners = np.unique(key, return_inverse=True)
    is_cut = key >= count
    tail, head = (vertices[np.where(is_cut, end, key)] for end in np.divmod(key - count, count))
    fall = np.where(is_cut, tail[:, 2] - head[:, 2], 1.0)
    t = np.where(is_cut, tail[:, 2] / fall, 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        points = tail + t[:, None] * (head - tail)
    points[is_cut, 2] = 0.0
    corners = corners.reshape(-1, 3)
    return Cut(points, corners, owner, kept, lost, t[corners])
