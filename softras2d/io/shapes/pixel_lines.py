"""Draws lines one pixel wide, as the course does, as rectangles of whole pixels.

The course draws a line by repeated float32 addition of a step, and colours the whole pixel of each
position. The rounding shows in the image, so it is reproduced. Runs of pixels along a row (along a
column for steep lines) become one rectangle. Many lines are stepped together. A line that starts
far from the canvas is advanced to it without single steps, with the same float32 result.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int

from ..budget import Budget, BudgetError

_LONG = 1 << 14
"""Lines of more steps than this are first advanced to the canvas."""

_BLOCK = 1 << 21
"""Positions that are computed in one block, which bounds memory."""

_NEVER = 1 << 30
"""Upper bound on steps that move a position: adding 1 changes a float32 at most 2^25 times."""


class _Walks(NamedTuple):
    """Lines to step along, one entry per line.

    - `x`, `y`: position at which stepping begins; `step_x`, `step_y`: one step.
    - `first_y`, `last_x`, `rise`: stepping ends past `last_x`, or `rise` away from `first_y`.
    - `steps`: upper bound on the number of steps.
    """

    x: np.ndarray
    y: np.ndarray
    step_x: np.ndarray
    step_y: np.ndarray
    first_y: np.ndarray
    last_x: np.ndarray
    rise: np.ndarray
    steps: np.ndarray

    def take(self, chosen: np.ndarray) -> "_Walks":
        return _Walks(*(field[chosen] for field in self))


def pixel_lines(
    segments: Float32[np.ndarray, "lines 4"],
    height: int,
    width: int,
    budget: Budget | None = None,
    triangles_each: Int[np.ndarray, " lines"] | None = None,
) -> tuple[Int[np.ndarray, "rectangles 4"], Int[np.ndarray, " rectangles"]]:
    """Rectangles `[r, 4]` (x0, y0, x1, y1) of the pixels that lines cover, and the line of each.

    `segments` are (x0, y0, x1, y1) in pixels. From the end with the smaller x (the first, if they
    are equal) steps go (1, m), or (1/|m|, sign m) where |m| > 1, while floor(x) has not passed the
    other end's and |y - y0| not the height; all in float32. Pixels off the canvas are left out.
    `triangles_each` is the number of triangles that a rectangle of each line will become. Raises
    `BudgetError`, with the index of the line, if steps or triangles exceed `budget`.
    """
    # Coordinates may be any float32; lines with infinite or undefined steps draw nothing.
    with np.errstate(all="ignore"):
        return _pixel_lines(segments, height, width, budget or Budget(), triangles_each)


def _pixel_lines(
    segments: np.ndarray, height: int, width: int, budget: Budget, each: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    walks = _walks(segments)
    near = np.flatnonzero(_may_touch(segments, walks, height, width))
    rectangles, owners = [np.zeros((0, 4), np.int64)], [np.zeros(0, np.int64)]
    walks = walks.take(near)
    walks, entered = _advance_long_lines(walks, height, width)
    near = near[entered]
    budget.charge_each("steps", walks.steps, near.tolist())
    order = np.argsort(walks.steps, kind="stable")
    place = 0
    while place < len(order):
        # Lines of similar length together, as many as a block holds of the longest.
        count = np.searchsorted(
            walks.steps[order[place:]] * np.arange(1, len(order) - place + 1), _BLOCK, "right"
        )
        chosen = order[place : place + max(int(count), 1)]
        place += len(chosen)
        found, line = _block(walks.take(chosen), height, width)
        # Charged block by block: what one makes is bounded.
        made = np.bincount(line, minlength=len(chosen)) * (
            1 if each is None else each[near[chosen]]
        )
        try:
            budget.charge_each("triangles", made)
        except BudgetError as error:
            raise BudgetError(str(error), int(near[chosen[error.index]])) from None
        rectangles.append(found)
        owners.append(near[chosen[line]])
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return np.concatenate(rectangles)[order], owner[order]


def _walks(segments: np.ndarray) -> _Walks:
    swap = segments[:, 0] > segments[:, 2]
    ordered = np.where(swap[:, None], segments[:, [2, 3, 0, 1]], segments)
    x, y, last_x, last_y = ordered.T
    one, zero = np.float32(1), np.float32(0)
    run, rise = last_x - x, last_y - y
    slope = rise / run
    steep = np.abs(slope) > 1
    step_x = np.where(steep, one / np.abs(slope), one)
    step_y = np.where(steep, np.sign(slope), slope)
    vertical = run == 0
    step_x = np.where(vertical, zero, step_x)
    step_y = np.where(vertical, np.sign(rise), step_y)
    # Rounding where a power of two is crossed may cost or save a step.
    reach = np.maximum(np.abs(run).astype(np.float64), np.abs(rise).astype(np.float64))
    steps = np.minimum(reach + 4, _NEVER).astype(np.int64)
    return _Walks(x, y, step_x, step_y, y, last_x, np.abs(rise), steps)


def _may_touch(segments: np.ndarray, walks: _Walks, height: int, width: int) -> np.ndarray:
    """Whether lines may meet a pixel of the canvas, with a margin for the rounding of steps."""
    wide = segments.astype(np.float64)
    # A step is rounded by half a unit in the last place, 2^-24 of the largest coordinate.
    slack = 2.0 + walks.steps * np.abs(wide).max(axis=1, initial=0.0) * 2.0**-24
    low = np.minimum(wide[:, :2], wide[:, 2:]) - slack[:, None]
    high = np.maximum(wide[:, :2], wide[:, 2:]) + slack[:, None]
    near = ((high >= 0) & (low <= (width, height))).all(axis=1)
    return near & np.isfinite(walks.step_x) & np.isfinite(walks.step_y)


def _advance_long_lines(walks: _Walks, height: int, width: int) -> tuple[_Walks, np.ndarray]:
    """Advance long lines to the canvas; returns the lines that reach it, and which ones do."""
    entered = np.ones(len(walks.steps), bool)
    x, y, steps = walks.x.copy(), walks.y.copy(), walks.steps.copy()
    for line in np.flatnonzero(walks.steps > _LONG).tolist():
        step_x, step_y = walks.step_x[line], walks.step_y[line]
        edge_y = -1.0 if step_y > 0 else height + 1.0
        _, by_x = advance(x[line], step_x, _NEVER, -1.0)
        _, by_y = advance(y[line], step_y, _NEVER, edge_y) if step_y else (y[line], 0)
        count = max(by_x, by_y)
        entered[line] = count < _NEVER
        x[line], _ = advance(x[line], step_x, count)
        y[line], _ = advance(y[line], step_y, count)
        # On one of the axes every step moves by a pixel, so it leaves the canvas by then.
        steps[line] = min(steps[line], max(height, width) + 8)
    moved = walks._replace(x=x, y=y, steps=steps)
    return moved.take(entered), entered


def advance(
    start: np.float32, step: np.float32, most: int, until: float | None = None
) -> tuple[np.float32, int]:
    """Add `step` to `start` in float32 until the value reaches `until`, at most `most` times.

    Returns the value and the number of additions. Between two powers of two, every addition is
    rounded by the same amount (a tie from the second addition on, since it goes to even). So all
    additions there are one multiplication, which is exact in float64. If `step` is too small to
    change the value, the number of additions is `most`.
    """
    if step < 0:
        value, count = advance(-start, -step, most, None if until is None else -until)
        return -value, count
    goal = np.inf if until is None else until
    value, count = start, 0
    while count < most and float(value) < goal:
        following = np.float32(value + step)
        if following == value:
            return value, most
        value, count = following, count + 1
        base = np.float32(value + step)
        gain = float(np.float32(base + step)) - float(base)
        # The powers of two between which `base` lies; upwards the nearer bound is the end.
        _, exponent = math.frexp(base)
        end = math.ldexp(1.0, exponent) if base > 0 else -math.ldexp(1.0, exponent - 1)
        if gain <= 0 or (value > 0) != (base > 0) or math.frexp(value)[1] != exponent:
            continue
        more = int(min((end - float(base)) / gain, (goal - float(base)) / gain, _NEVER)) - 1
        more = min(more, most - count - 1)
        if more > 0:
            value, count = np.float32(float(base) + more * gain), count + 1 + more
    return value, count


def _block(walks: _Walks, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Step along lines of similar length; returns rectangles and the line of each."""
    shape = (len(walks.x), int(walks.steps.max(initial=1)))
    x, y = np.empty(shape, np.float32), np.empty(shape, np.float32)
    for positions, start, step in ((x, walks.x, walks.step_x), (y, walks.y, walks.step_y)):
        positions[:, 0], positions[:, 1:] = start, step[:, None]
        # `accumulate` adds one after the other, as the course does; a sum would not.
        np.add.accumulate(positions, axis=1, out=positions)
    is_on_line = (np.floor(x) <= np.floor(walks.last_x)[:, None]) & (
        np.abs(y - walks.first_y[:, None]) <= walks.rise[:, None]
    )
    is_drawn = is_on_line & (x >= 0) & (x < width) & (y >= 0) & (y < height)
    line, _ = np.nonzero(is_drawn)
    column, row = np.floor(x[is_drawn]).astype(np.int64), np.floor(y[is_drawn]).astype(np.int64)
    return _runs(line, column, row, (walks.step_x < 1)[line])


def _runs(
    line: np.ndarray, column: np.ndarray, row: np.ndarray, steep: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Join neighbouring pixels of a line along its longer axis; repeated pixels count once."""
    if len(line) == 0:
        return np.zeros((0, 4), np.int64), line
    right, down = np.abs(np.diff(column)), np.abs(np.diff(row))
    joined = np.where(steep[1:], (right == 0) & (down <= 1), (down == 0) & (right <= 1))
    begins = np.flatnonzero(np.concatenate([[True], ~joined | (line[1:] != line[:-1])]))
    rectangles = np.stack(
        [
            np.minimum.reduceat(column, begins),
            np.minimum.reduceat(row, begins),
            np.maximum.reduceat(column, begins) + 1,
            np.maximum.reduceat(row, begins) + 1,
        ],
        axis=1,
    )
    return rectangles, line[begins]
