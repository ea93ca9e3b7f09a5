"""Draws lines one pixel wide, as the course does, as rectangles of whole pixels.

The *course* is a rasterizer course whose subset of SVG `read_svg` reads as dialect `"course"`. It
draws a line by repeated float32 addition of a step, and colours the whole pixel that contains each
position. The rounding is visible in the image, so it is reproduced. A run of pixels along a row, or
along a column for steep lines, becomes one rectangle. The positions of many lines are computed
together. A long line that starts outside the canvas is advanced to it without single steps, with
the same float32 result.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int

from ..budget import Budget

_LONG_STEPS = 1 << 14
"""Number of steps above which a line is advanced to the canvas without single steps."""

_BLOCK_POSITIONS = 1 << 21
"""Maximum number of positions of several lines that are computed at once, which bounds memory."""

_MAX_STEPS = 1 << 30
"""Maximum number of steps of a line.

No further step changes a position: adding one number repeatedly changes a float32 far fewer times.
"""


class _Walks(NamedTuple):
    """Lines to step along, in pixels.

    - `x`, `y`: position at which stepping begins.
    - `step_x`, `step_y`: what one step adds to x and y.
    - `first_y`, `last_x`, `rise`: stepping ends when floor(x) > floor(`last_x`), or when
      |y - `first_y`| > `rise`.
    - `steps`: upper bound on the number of steps.
    """

    x: Float32[np.ndarray, " lines"]
    y: Float32[np.ndarray, " lines"]
    step_x: Float32[np.ndarray, " lines"]
    step_y: Float32[np.ndarray, " lines"]
    first_y: Float32[np.ndarray, " lines"]
    last_x: Float32[np.ndarray, " lines"]
    rise: Float32[np.ndarray, " lines"]
    steps: Int[np.ndarray, " lines"]

    def take(self, chosen: np.ndarray) -> "_Walks":
        """The lines for which `chosen` is true, or whose indices it has."""
        return _Walks(*(field[chosen] for field in self))


def pixel_lines(
    segments: Float32[np.ndarray, "lines 4"],
    height: int,
    width: int,
    budget: Budget | None = None,
    triangles_each: Int[np.ndarray, " lines"] | None = None,
) -> tuple[Int[np.ndarray, "rectangles 4"], Int[np.ndarray, " rectangles"]]:
    """Cover lines one pixel wide with rectangles of whole pixels, as the rasterizer course does.

    - `segments`: the lines, as (x0, y0, x1, y1) in pixels.
    - `height`, `width`: size of the canvas in pixels. Pixels outside it are left out.
    - `triangles_each`: for each line, the number of triangles that each of its rectangles will
      become, which is charged to `budget`; 1 by default.

    Returns the rectangles, and for each the index of its line. Rectangles are (x0, y0, x1, y1) too,
    with x1 and y1 exclusive, and are sorted by line. Stepping starts at the end with the smaller x,
    or at (x0, y0) if both x are equal. For a slope m, a step is (1, m), or (1/|m|, sign m) if |m| >
    1. Stepping goes on while floor(x) is at most the floor of the other end's x, and y is at most
    |y1 - y0| from its start. All numbers are float32. A line of zero length is one pixel; a line
    whose step is not finite has none.

    Raises `BudgetError`, with the index of the line, if steps or triangles exceed `budget`.
    """
    # Coordinates may be any float32; lines with infinite or undefined steps draw nothing.
    with np.errstate(all="ignore"):
        return _pixel_lines(segments, height, width, budget or Budget(), triangles_each)


def _pixel_lines(
    segments: Float32[np.ndarray, "lines 4"],
    height: int,
    width: int,
    budget: Budget,
    triangles_each: Int[np.ndarray, " lines"] | None,
) -> tuple[Int[np.ndarray, "rectangles 4"], Int[np.ndarray, " rectangles"]]:
    """Do the work of `pixel_lines`, which has the same arguments and result.

    The caller switches NumPy's warnings about overflow and invalid values off.
    """
    walks = _walks(segments)
    # Walk k belongs to line `lines[k]`.
    lines = np.flatnonzero(_may_touch(segments, walks, height, width))
    walks, reaches_canvas = _advance_long_lines(walks.take(lines), height, width)
    lines = lines[reaches_canvas]
    if triangles_each is None:
        triangles_each = np.ones(len(segments), np.int64)
    budget.charge_each("steps", walks.steps, lines.tolist())
    rectangles, owners = [np.zeros((0, 4), np.int64)], [np.zeros(0, np.int64)]
    order = np.argsort(walks.steps, kind="stable")
    start = 0
    while start < len(order):
        # A block is an array with as many columns as its longest line has steps, so lines of
        # similar length share a block.
        count = np.searchsorted(
            walks.steps[order[start:]] * np.arange(1, len(order) - start + 1),
            _BLOCK_POSITIONS,
            "right",
        )
        chosen = order[start : start + max(int(count), 1)]
        start += len(chosen)
        block_rectangles, walk = _block(walks.take(chosen), height, width)
        # Charged block by block, since the rectangles of one block are bounded.
        counts = np.bincount(walk, minlength=len(chosen)) * triangles_each[lines[chosen]]
        budget.charge_each("triangles", counts, lines[chosen].tolist())
        rectangles.append(block_rectangles)
        owners.append(lines[chosen[walk]])
    owner = np.concatenate(owners)
    order = np.argsort(owner, kind="stable")
    return np.concatenate(rectangles)[order], owner[order]


def _walks(segments: Float32[np.ndarray, "lines 4"]) -> _Walks:
    """Compute the start, step and end of each line in float32, by the rule of `pixel_lines`.

    `segments` are (x0, y0, x1, y1) in pixels. Steps may be infinite or NaN for extreme coordinates.
    """
    swap = segments[:, 0] > segments[:, 2]
    ordered = np.where(swap[:, None], segments[:, [2, 3, 0, 1]], segments)
    x, y, last_x, last_y = ordered.T
    one, zero = np.float32(1), np.float32(0)
    run, rise = last_x - x, last_y - y
    slope = rise / run
    is_steep, is_vertical = np.abs(slope) > 1, run == 0
    step_x = np.where(is_steep, one / np.abs(slope), one)
    step_y = np.where(is_steep, np.sign(slope), slope)
    step_x = np.where(is_vertical, zero, step_x)
    step_y = np.where(is_vertical, np.sign(rise), step_y)
    # Rounding where a power of two is crossed may cost or save a step.
    reach = np.maximum(np.abs(run).astype(np.float64), np.abs(rise).astype(np.float64))
    steps = np.minimum(reach + 4, _MAX_STEPS).astype(np.int64)
    return _Walks(x, y, step_x, step_y, y, last_x, np.abs(rise), steps)


def _may_touch(
    segments: Float32[np.ndarray, "lines 4"], walks: _Walks, height: int, width: int
) -> Bool[np.ndarray, " lines"]:
    """Whether each line may colour a pixel of the canvas, with a margin for the rounding of steps.

    False for lines whose step is not finite.
    """
    ends = segments.astype(np.float64)
    # A step is rounded by at most half a unit in the last place, 2^-24 of the largest coordinate.
    margin = 2.0 + walks.steps * np.abs(ends).max(axis=1, initial=0.0) * 2.0**-24
    low = np.minimum(ends[:, :2], ends[:, 2:]) - margin[:, None]
    high = np.maximum(ends[:, :2], ends[:, 2:]) + margin[:, None]
    is_near = ((high >= 0) & (low <= (width, height))).all(axis=1)
    return is_near & np.isfinite(walks.step_x) & np.isfinite(walks.step_y)


def _advance_long_lines(
    walks: _Walks, height: int, width: int
) -> tuple[_Walks, Bool[np.ndarray, " lines"]]:
    """Advance lines of more than `_LONG_STEPS` steps to the canvas; leave others as they are.

    An advanced line begins where it comes to the canvas, and its number of steps is reduced to what
    crossing the canvas takes. Returns two things: the lines without those that would not reach the
    canvas within `_MAX_STEPS` steps, and for each of `walks`, whether it is among these lines.
    """
    reaches_canvas = np.ones(len(walks.steps), bool)
    x, y, steps = walks.x.copy(), walks.y.copy(), walks.steps.copy()
    for line in np.flatnonzero(walks.steps > _LONG_STEPS).tolist():
        step_x, step_y = walks.step_x[line], walks.step_y[line]
        edge_y = -1.0 if step_y > 0 else height + 1.0
        _, steps_in_x = advance(x[line], step_x, _MAX_STEPS, -1.0)
        _, steps_in_y = advance(y[line], step_y, _MAX_STEPS, edge_y) if step_y else (y[line], 0)
        count = max(steps_in_x, steps_in_y)
        reaches_canvas[line] = count < _MAX_STEPS
        x[line], _ = advance(x[line], step_x, count)
        y[line], _ = advance(y[line], step_y, count)
        # A step is one pixel long on one of the axes, so the line leaves the canvas after these.
        steps[line] = min(steps[line], max(height, width) + 8)
    moved = walks._replace(x=x, y=y, steps=steps)
    return moved.take(reaches_canvas), reaches_canvas


def advance(
    start: np.float32, step: np.float32, most: int, until: float | None = None
) -> tuple[np.float32, int]:
    """Add `step` to `start` in float32 until the value reaches `until`, at most `most` times.

    For a positive step, the value reaches `until` when it is at least `until`; for a negative step,
    when it is at most `until`. None means that only `most` ends the additions. Returns the value
    and the number of additions, which is `most` if `step` is too small to change the value.

    Between two powers of two, every addition is rounded by the same amount, except that a tie,
    which goes to even, may differ once. All further additions up to the next power of two therefore
    amount to one multiplication, which is exact in float64.
    """
    if step < 0:
        value, count = advance(-start, -step, most, None if until is None else -until)
        return -value, count
    goal = np.inf if until is None else until
    value, count = start, 0
    while count < most and float(value) < goal:
        next_value = np.float32(value + step)
        if next_value == value:
            return value, most
        value, count = next_value, count + 1
        base = np.float32(value + step)
        increment = float(np.float32(base + step)) - float(base)
        # The upper one of the powers of two between which `base` lies.
        _, exponent = math.frexp(base)
        end = math.ldexp(1.0, exponent) if base > 0 else -math.ldexp(1.0, exponent - 1)
        if increment <= 0 or (value > 0) != (base > 0) or math.frexp(value)[1] != exponent:
            continue
        nearest = min(end, goal) - float(base)
        equal_steps = int(min(nearest / increment, _MAX_STEPS)) - 1
        equal_steps = min(equal_steps, most - count - 1)
        if equal_steps > 0:
            value = np.float32(float(base) + equal_steps * increment)
            count += 1 + equal_steps
    return value, count


def _block(
    walks: _Walks, height: int, width: int
) -> tuple[Int[np.ndarray, "rectangles 4"], Int[np.ndarray, " rectangles"]]:
    """Step along lines of similar length; returns rectangles, and for each the index of its line.

    Rectangles are (x0, y0, x1, y1) in pixels, with x1 and y1 exclusive. The index is that of the
    line in `walks`.
    """
    shape = (len(walks.x), int(walks.steps.max(initial=1)))
    x, y = np.empty(shape, np.float32), np.empty(shape, np.float32)
    for positions, start, step in ((x, walks.x, walks.step_x), (y, walks.y, walks.step_y)):
        positions[:, 0], positions[:, 1:] = start, step[:, None]
        # `accumulate` adds one step after the other, as the course does; `sum` adds in pairs.
        np.add.accumulate(positions, axis=1, out=positions)
    is_on_line = (np.floor(x) <= np.floor(walks.last_x)[:, None]) & (
        np.abs(y - walks.first_y[:, None]) <= walks.rise[:, None]
    )
    is_drawn = is_on_line & (x >= 0) & (x < width) & (y >= 0) & (y < height)
    line, _ = np.nonzero(is_drawn)
    column, row = np.floor(x[is_drawn]).astype(np.int64), np.floor(y[is_drawn]).astype(np.int64)
    return _runs(line, column, row, (walks.step_x < 1)[line])


def _runs(
    line: Int[np.ndarray, " pixels"],
    column: Int[np.ndarray, " pixels"],
    row: Int[np.ndarray, " pixels"],
    is_steep: Bool[np.ndarray, " pixels"],
) -> tuple[Int[np.ndarray, "rectangles 4"], Int[np.ndarray, " rectangles"]]:
    """Join the pixels of each line into rectangles along its longer axis.

    - `line`: index of the line of each pixel. Pixels of a line are consecutive, in drawing order.
    - `column`, `row`: coordinates of each pixel. A pixel may be repeated.
    - `is_steep`: whether the line of each pixel is joined along columns, instead of rows.

    Returns rectangles (x0, y0, x1, y1), with x1 and y1 exclusive, and for each the index of its
    line.
    """
    if len(line) == 0:
        return np.zeros((0, 4), np.int64), line
    dx, dy = np.abs(np.diff(column)), np.abs(np.diff(row))
    is_joined = np.where(is_steep[1:], (dx == 0) & (dy <= 1), (dy == 0) & (dx <= 1))
    starts = np.flatnonzero(np.concatenate([[True], ~is_joined | (line[1:] != line[:-1])]))
    rectangles = np.stack(
        [
            np.minimum.reduceat(column, starts),
            np.minimum.reduceat(row, starts),
            np.maximum.reduceat(column, starts) + 1,
            np.maximum.reduceat(row, starts) + 1,
        ],
        axis=1,
    )
    return rectangles, line[starts]
