"""Triangulates strokes: a quad per segment, joins between segments, caps at open ends.

All strokes of a drawing are triangulated together. The pieces of one stroke overlap, so a
translucent stroke is replaced by their `union`. Dashes, markers and the joins `arcs` and
`miter-clip` are not supported.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely
from jaxtyping import Float, Int

from ..budget import Budget
from .overlaps import charge_overlaps

_TOLERANCE = 0.02
"""Maximum distance, in pixels, between the chords of round joins and caps and the circle."""


class Outline(NamedTuple):
    """A chain of segments to stroke.

    - `points`: `[n, 2]`.
    - `closed`: whether a segment joins the last point to the first.
    - `width`: in the units of the points.
    - `scale`: pixels per unit, from which the number of chords of an arc follows.
    - `cap`: `butt`, `square` or `round`.
    - `join`: `miter`, `bevel` or `round`; a miter longer than `miterlimit` widths is a bevel.
    """

    points: np.ndarray
    closed: bool
    width: float
    cap: str = "butt"
    join: str = "miter"
    miterlimit: float = 4.0
    scale: float = 1.0


def stroke(
    outlines: Sequence[Outline], budget: Budget | None = None
) -> tuple[Float[np.ndarray, "triangles 3 2"], Int[np.ndarray, " triangles"]]:
    """Triangulate strokes; returns triangles `[t, 3, 2]` and the outline of each, in order.

    Segments of zero length are dropped; an outline without segments draws a dot if its caps are
    round or square. Raises `BudgetError`, with the index of the outline, if the triangles exceed
    `budget`.

    **Source:** SVG 2, sections 13.5.4 to 13.5.6.
    """
    budget = budget or Budget()
    half = np.array([outline.width / 2 for outline in outlines])
    closed = np.array([outline.closed for outline in outlines], bool)
    cap = np.array([outline.cap for outline in outlines])
    join = np.array([outline.join for outline in outlines])
    limit = np.array([outline.miterlimit for outline in outlines])
    radius_px = half * np.array([outline.scale for outline in outlines])
    edges = _edges(outlines)
    counts = 2 * np.bincount(edges.owner, minlength=len(outlines))
    side = half[edges.owner, None] * _left(edges.along)
    a, b = edges.start, edges.end
    pieces = [_quads(edges.owner, a + side, b + side, b - side, a - side)]
    bends = _bends(edges, closed, half)
    sharp = _is_sharp(bends, limit)
    rounded = join[bends.owner] == "round"
    mitred = (join[bends.owner] == "miter") & ~sharp
    arcs = bends.take(rounded)
    owner, place, outward = _ends(edges, closed, outlines)
    has_square, has_round = cap[owner] == "square", cap[owner] == "round"
    half_turn = np.full(int(has_round.sum()), -np.pi)
    for owners, triangles in (
        (bends.owner[~rounded], np.where(mitred[~rounded], 2, 1)),
        (arcs.owner, _sector_counts(arcs.owner, arcs.turn, radius_px)),
        (owner[has_square], np.full(int(has_square.sum()), 2)),
        (owner[has_round], _sector_counts(owner[has_round], half_turn, radius_px)),
    ):
        counts += np.bincount(owners, triangles, minlength=len(outlines)).astype(np.int64)
    budget.charge_each("triangles", counts)
    pieces.append(_bevels(bends.take(~rounded & ~mitred)))
    pieces.append(_miters(bends.take(mitred)))
    pieces.append(_sectors(arcs.owner, arcs.place, arcs.first, arcs.turn, radius_px))
    side = half[owner, None] * _left(outward)
    far = place + half[owner, None] * outward
    pieces.append(
        _quads(
            *(v[has_square] for v in (owner, place + side, far + side, far - side, place - side))
        )
    )
    pieces.append(
        _sectors(owner[has_round], place[has_round], side[has_round], half_turn, radius_px)
    )
    owner = np.concatenate([piece[0] for piece in pieces])
    order = np.argsort(owner, kind="stable")
    return np.concatenate([piece[1] for piece in pieces])[order], owner[order]


def union(
    triangles: Float[np.ndarray, "triangles 3 2"], budget: Budget | None = None, index: int = 0
) -> Any:
    """Union of overlapping triangles, as a shapely (multi)polygon.

    Pairs of triangles that overlap are charged to `budget`; `index` is the shape in errors.
    """
    edges = np.diff(triangles, axis=1)
    areas = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    triangles = triangles[areas != 0]
    boxes = np.concatenate([triangles.min(axis=1), triangles.max(axis=1)], axis=1)
    charge_overlaps(boxes, budget or Budget(), index)
    return shapely.union_all(shapely.polygons(triangles))


class _Edges(NamedTuple):
    """Segments of positive length, in order: outline, ends and unit direction `along`."""

    owner: np.ndarray
    start: np.ndarray
    end: np.ndarray
    along: np.ndarray


class _Bends(NamedTuple):
    """Corners at which two segments meet.

    - `owner`: the outline; `place`: the position of the corner.
    - `first`, `last`: vectors from the corner to the outer side of the segment before and after.
    - `turn`: angle between the segments, in radians, positive from x to y.
    """

    owner: np.ndarray
    place: np.ndarray
    first: np.ndarray
    last: np.ndarray
    turn: np.ndarray

    def take(self, chosen: np.ndarray) -> "_Bends":
        return _Bends(*(field[chosen] for field in self))


_Piece = tuple[np.ndarray, np.ndarray]
"""The owners `[k]` of triangles `[k, 3, 2]`."""


def _edges(outlines: Sequence[Outline]) -> _Edges:
    chains = [
        np.concatenate([line.points, line.points[:1]]) if line.closed else line.points
        for line in outlines
    ]
    points = np.concatenate([np.zeros((0, 2)), *chains])
    chain = np.repeat(np.arange(len(chains)), [len(points) for points in chains])
    step = np.diff(points, axis=0)
    lengths = np.hypot(step[:, 0], step[:, 1])
    kept = np.flatnonzero((np.diff(chain) == 0) & (lengths > 0))
    along = step[kept] / lengths[kept, None]
    return _Edges(chain[kept], points[kept], points[kept + 1], along)


def _bends(edges: _Edges, closed: np.ndarray, half: np.ndarray) -> _Bends:
    """The corners of all outlines at which the direction changes."""
    count = len(edges.owner)
    firsts = np.flatnonzero(np.diff(edges.owner, prepend=-1))
    after = np.arange(count)
    before = after - 1
    # The first edge of a closed outline follows its last.
    before[firsts] = np.append(firsts[1:], count)[: len(firsts)] - 1
    joined = np.ones(count, bool)
    joined[firsts] = closed[edges.owner[firsts]]
    before, after = edges.along[before[joined]], edges.along[joined]
    owner, place = edges.owner[joined], edges.start[joined]
    turn = np.arctan2(_cross(before, after), (before * after).sum(axis=1))
    # The outer side is to the right of a left bend and to the left of a right one.
    out = np.where(turn > 0, -half[owner], half[owner])[:, None]
    bends = _Bends(owner, place, out * _left(before), out * _left(after), turn)
    return bends.take(turn != 0)


def _is_sharp(bends: _Bends, limit: np.ndarray) -> np.ndarray:
    """Whether a miter, whose length is 1 / cos(turn / 2) widths, exceeds its limit."""
    return limit[bends.owner] * np.cos(bends.turn / 2) < 1.0


def _bevels(bends: _Bends) -> _Piece:
    place = bends.place
    return bends.owner, np.stack([place, place + bends.first, place + bends.last], axis=1)


def _miters(bends: _Bends) -> _Piece:
    # The tip lies along first + last, whose length is 2 half cos(turn / 2).
    tip = (bends.first + bends.last) / (2 * np.cos(bends.turn / 2)[:, None] ** 2)
    place = bends.place
    return _quads(bends.owner, place, place + bends.first, place + tip, place + bends.last)


def _ends(
    edges: _Edges, closed: np.ndarray, outlines: Sequence[Outline]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Owner, position and outward direction of every end that gets a cap."""
    firsts = np.flatnonzero(np.diff(edges.owner, prepend=-1))
    lasts = np.append(firsts[1:], len(edges.owner))[: len(firsts)] - 1
    is_open = ~closed[edges.owner[firsts]]
    firsts, lasts = firsts[is_open], lasts[is_open]
    lone = np.setdiff1d(np.arange(len(outlines)), edges.owner)
    lone = np.array([i for i in lone.tolist() if len(outlines[i].points)], np.int64)
    dots = np.array([outlines[i].points[0] for i in lone.tolist()]).reshape(-1, 2)
    right = np.tile([1.0, 0.0], (len(lone), 1))
    owner = np.concatenate([edges.owner[firsts], edges.owner[lasts], lone, lone])
    place = np.concatenate([edges.start[firsts], edges.end[lasts], dots, dots])
    outward = np.concatenate([-edges.along[firsts], edges.along[lasts], right, -right])
    return owner, place, outward


def _quads(owner: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> _Piece:
    """Two triangles per quad, whose corners are the rows of a, b, c and d, in order around it."""
    return np.repeat(owner, 2), np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3, 2)


def _sectors(
    owner: np.ndarray,
    place: np.ndarray,
    first: np.ndarray,
    turn: np.ndarray,
    radius_px: np.ndarray,
) -> _Piece:
    """Circular sectors as fans of triangles, from the radius `first` through `turn` radians."""
    counts = _sector_counts(owner, turn, radius_px)
    which = np.repeat(np.arange(len(owner)), counts)
    part_index = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
    angle = turn[which] / counts[which]
    rim = [place[which] + _rotate(first[which], angle * (part_index + k)) for k in (0, 1)]
    return owner[which], np.stack([place[which], *rim], axis=1)


def _sector_counts(owner: np.ndarray, turn: np.ndarray, radius_px: np.ndarray) -> np.ndarray:
    """Number of triangles of each sector, so that chords stay within `_TOLERANCE`."""
    radius = np.maximum(radius_px[owner], _TOLERANCE)
    part = np.maximum(2 * np.arccos(1.0 - _TOLERANCE / radius), np.pi / 512)
    return np.maximum(np.ceil(np.abs(turn) / part), 1).astype(np.int64)


def _rotate(vectors: np.ndarray, angle: np.ndarray) -> np.ndarray:
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = vectors.T
    return np.stack([x * cos - y * sin, x * sin + y * cos], axis=-1)


def _left(along: np.ndarray) -> np.ndarray:
    """Directions turned by 90 degrees, from x to y."""
    return np.stack([-along[:, 1], along[:, 0]], axis=-1)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
