"""Cuts chains of segments into the dashes of a dashed stroke."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from ..budget import Budget

_DOT = 1e-6
"""Minimum length of a dash, in periods of the pattern, to which shorter dashes are lengthened.

The caps of a dash of length 0 would have no direction.
"""


def dashes(
    points: Float[np.ndarray, "n 2"],
    smooth: Bool[np.ndarray, " n"],
    closed: bool,
    pattern: Sequence[float],
    offset: float,
    budget: Budget,
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Cut a chain of segments into dashes; returns points `[k, 2]` and `smooth` `[k]` of each dash.

    Dashes are open chains, in the order in which they lie on the chain. Their ends are not smooth.

    - `points`: the chain, in any unit.
    - `smooth`: whether each point lies inside a flattened curve.
    - `closed`: whether a segment joins the last point to the first.
    - `pattern`: lengths of dashes and gaps in turn, in the units of `points`: an even number of
      lengths, with a positive sum.
    - `offset`: distance from the start of the pattern at which the chain begins; it may be
      negative, since the pattern repeats in both directions.
    - `budget`: charged in advance, with four points for each dash and each gap there may be.

    If a closed chain begins and ends within a dash, the two pieces are joined to one dash, which
    comes first. A chain of length zero is returned uncut, and so is one whose number of periods is
    not finite. If an uncut chain is closed, its first point is repeated at its end. Raises
    `BudgetError` if the dashes need more points than `budget` allows.

    **Source:** SVG 2, section 13.5.6.
    """
    if closed:
        points, smooth = np.concatenate([points, points[:1]]), np.append(smooth, smooth[:1])
    step = np.hypot(*np.diff(points, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(step)])
    total, period = float(along[-1]), float(sum(pattern))
    if total == 0 or not np.isfinite(total / period):
        return [(points, smooth)]
    # A dash takes about four points, and time even if it lies outside of the canvas.
    budget.charge("points", int(min(4 * len(pattern) * (total / period + 2), 2.0**60)))
    first_period = np.floor(offset / period)
    count = int(np.ceil(total / period)) + 2
    bounds = np.concatenate([[0.0], np.cumsum(pattern)])
    begins = (np.arange(count)[:, None] + first_period) * period + bounds[:-1:2] - offset
    ends = (np.arange(count)[:, None] + first_period) * period + bounds[1::2] - offset
    begins, ends = begins.ravel(), np.maximum(ends, begins + _DOT * period).ravel()
    is_inside = (ends > 0) & (begins < total)
    begins, ends = np.maximum(begins[is_inside], 0), np.minimum(ends[is_inside], total)
    # Where points coincide, interpolation may take either of them.
    cut_x, cut_y = (np.interp(np.stack([begins, ends]), along, points[:, axis]) for axis in (0, 1))
    cuts = np.stack([cut_x, cut_y], axis=-1)
    first = np.searchsorted(along, begins, side="right")
    last = np.searchsorted(along, ends, side="left")
    pieces = [
        (
            np.concatenate([cuts[0, k : k + 1], points[first[k] : last[k]], cuts[1, k : k + 1]]),
            np.concatenate([[False], smooth[first[k] : last[k]], [False]]),
        )
        for k in range(len(begins))
    ]
    if closed and len(pieces) > 1 and begins[0] == 0 and ends[-1] == total:
        (last_points, last_smooth), (first_points, first_smooth) = pieces.pop(), pieces[0]
        joined = np.append(last_smooth[:-1], smooth[0])
        pieces[0] = (
            np.concatenate([last_points, first_points[1:]]),
            np.concatenate([joined, first_smooth[1:]]),
        )
    return pieces
