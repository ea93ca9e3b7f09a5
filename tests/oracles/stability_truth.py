"""Soft coverage, exact area and their derivatives in float64 numpy; no code of the package.

The derivative of coverage by a corner is a central difference, over a step far below every length
of the case. Images are composited by hand, and multilinear in coverages and colours: their
derivatives follow from what lies in front and behind.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

Coverage = Callable[[np.ndarray], np.ndarray]
"""From corners `[3, 2]` to `[height, width]`."""


def centres(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[:height, :width] + 0.5
    return x, y


def oriented(corners: np.ndarray) -> tuple[np.ndarray, float]:
    """Positively oriented corners, and the sign of the area that they had."""
    (ax, ay), (bx, by) = corners[1] - corners[0], corners[2] - corners[0]
    sign = float(np.sign(ax * by - ay * bx))
    return (corners[[0, 2, 1]] if sign < 0 else corners), sign


def distance(corners: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Signed distance in pixels, positive inside; without area there is no inside."""
    corners, sign = oriented(corners)
    least, inside = np.full(x.shape, np.inf), np.full(x.shape, sign != 0)
    for k in range(3):
        (px, py), (ex, ey) = corners[k], corners[(k + 1) % 3] - corners[k]
        wx, wy = x - px, y - py
        square = ex * ex + ey * ey
        t = np.clip((wx * ex + wy * ey) / square, 0, 1) if square > 0 else np.zeros(x.shape)
        least = np.minimum(least, np.hypot(wx - t * ex, wy - t * ey))
        inside &= ex * wy - ey * wx >= 0
    return np.where(inside, least, -least)


def soft(height: int, width: int, softness: float) -> Coverage:
    """The logistic profile: cut at 6, rescaled, and 0.9 at half a `softness` in pixels."""
    x, y = centres(height, width)
    rest = 1 / (1 + math.exp(6))
    high = 0.9 - 0.8 * rest
    per_pixel = 2 * math.log(high / (1 - high)) / softness

    def cover(corners: np.ndarray) -> np.ndarray:
        z = np.clip(distance(corners, x, y) * per_pixel, -6, 6)
        return (1 / (1 + np.exp(-z)) - rest) / (1 - 2 * rest)

    return cover


def area(height: int, width: int) -> Coverage:
    """The area in each pixel: the mean length of level cuts, linear between those at corners."""
    x, y = (c[..., None] - 0.5 for c in centres(height, width))

    def cover(corners: np.ndarray) -> np.ndarray:
        ends = [(corners[k], corners[(k + 1) % 3]) for k in range(3)]
        bends = [np.broadcast_to(y, x.shape), np.broadcast_to(y + 1, x.shape)]
        bends += [np.full(x.shape, corner[1]) for corner in corners]
        for p, q in ends:
            run = q[0] - p[0]
            if run != 0:
                bends += [p[1] + (x + side - p[0]) * ((q[1] - p[1]) / run) for side in (0, 1)]
        level = np.sort(np.clip(np.concatenate(bends, -1), y, y + 1), -1)
        middle = 0.5 * (level[..., 1:] + level[..., :-1])
        left, right = np.full(middle.shape, np.inf), np.full(middle.shape, -np.inf)
        for p, q in ends:
            rise = q[1] - p[1]
            if rise == 0:
                continue
            cut = p[0] + (middle - p[1]) / rise * (q[0] - p[0])
            on = (middle >= min(p[1], q[1])) & (middle <= max(p[1], q[1]))
            left = np.where(on, np.minimum(left, cut), left)
            right = np.where(on, np.maximum(right, cut), right)
        length = np.clip(right, x, x + 1) - np.clip(left, x, x + 1)
        return np.sum(np.diff(level) * np.where(right > left, length, 0), -1)

    return cover


def slopes(cover: Coverage, corners: np.ndarray, step: float) -> np.ndarray:
    """Central differences `[3, 2, height, width]`."""
    found = []
    for k, axis in np.ndindex(3, 2):
        change = np.zeros((3, 2))
        change[k, axis] = step
        found.append((cover(corners + change) - cover(corners - change)) / (2 * step))
    return np.stack(found).reshape(3, 2, *found[0].shape)


class Scale(NamedTuple):
    """Lengths in pixels.

    - `rounding`: by which the corners of a scene are not known; `smooth`: over which slopes change
      where they have no bend.
    - `compares`: whether coverage depends on which edge is nearer, not on the sign of areas alone.
    """

    rounding: float
    smooth: float
    compares: bool

    def of(self, corners: np.ndarray) -> tuple[float, float]:
        """The step of differences for a triangle, and by how much its corners may be moved."""
        sides = corners - np.roll(corners, 1, 0)
        (ax, ay), (bx, by) = sides[:2]
        longest = np.hypot(*sides.T).max()
        height = abs(ax * by - ay * bx) / longest if longest > 0 else 0.0
        if height == 0:
            return 1e-5 * self.smooth, self.rounding
        step = min(1e-5 * self.smooth, 1e-3 * height)
        return step, self.rounding if self.compares else min(self.rounding, 1e-2 * height)


def is_bend(cover: Coverage, corners: np.ndarray, by: np.ndarray, scale: Scale) -> np.ndarray:
    """Pixels whose slopes jump within a rounding of the corners: no float32 program can tell them.

    Such as those with a vertex on their centre, or with two edges as near to it as each other.
    """
    rng = np.random.default_rng(0)
    step, rounding = scale.of(corners)
    most = max(1.0, float(np.abs(by).max()))
    found = np.zeros(by.shape[2:], bool)
    for _ in range(6):
        near = corners + rng.choice([-1.0, 1.0], (3, 2)) * rounding
        jump = np.abs(slopes(cover, near, step) - by).max((0, 1))
        found |= jump > 8 * rounding / scale.smooth * most
    return found


class Jacobian(NamedTuple):
    """An image, and its derivatives with respect to what a scene of flat triangles holds.

    - `image`: `[height, width, 3]`; `corners`: `[n, 3, 2, height, width, 3]`.
    - `shade`: by a triangle's own colour, `[n, height, width]`; `alpha`: `[n, height, width, 3]`.
    - `paper`: by the background's colour, `[height, width]`.
    - `bends`: `[height, width]`, pixels whose derivative by corners is not known.
    """

    image: np.ndarray
    corners: np.ndarray
    shade: np.ndarray
    alpha: np.ndarray
    paper: np.ndarray
    bends: np.ndarray

    def forward(self, corners: np.ndarray, colors: np.ndarray, paper: np.ndarray) -> np.ndarray:
        """J v, for `[n, 3, 2]`, RGBA `[n, 4]` and `[3]`."""
        total = np.einsum("nkahwc,nka->hwc", self.corners, corners)
        total += np.einsum("nhw,nc->hwc", self.shade, colors[:, :3])
        total += np.einsum("nhwc,n->hwc", self.alpha, colors[:, 3])
        return total + self.paper[..., None] * paper

    def backward(self, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """J^T w, for the same three."""
        corners = np.einsum("nkahwc,hwc->nka", self.corners, weight)
        shade = np.einsum("nhw,hwc->nc", self.shade, weight)
        alpha = np.einsum("nhwc,hwc->n", self.alpha, weight)
        return (
            corners,
            np.append(shade, alpha[:, None], 1),
            np.einsum("hw,hwc->c", self.paper, weight),
        )


def jacobian(
    cover: Coverage,
    corners: np.ndarray,
    colors: np.ndarray,
    paper: np.ndarray,
    *,
    scale: Scale,
    summed: bool = False,
) -> Jacobian:
    """Of triangles `[n, 3, 2]` in RGBA `[n, 4]`, "over" in draw order or summed with their signs.

    A triangle with a corner that is not finite covers nothing.
    """
    finite = np.all(np.isfinite(corners), axis=(1, 2))
    corners = np.where(finite[:, None, None], corners, 0.0)
    (ax, ay), (bx, by) = ((corners[:, k] - corners[:, 0]).T for k in (1, 2))
    twice = ax * by - ay * bx
    signs, whole = np.sign(twice), -1.0 if twice.sum() < 0 else 1.0
    covered, moved, bends = [], [], None
    for own, there in zip(corners, finite, strict=True):
        covered.append(cover(own) * there)
        moved.append(slopes(cover, own, scale.of(own)[0]) * there)
        bend = is_bend(cover, own, moved[-1], scale) & there
        bends = bend if bends is None else bends | bend
    c, dc, alpha = np.stack(covered), np.stack(moved), colors[:, 3, None, None]
    if summed:
        sign = (signs * whole)[:, None, None]
        jump = (colors[:, :3] - paper)[:, None, None] * sign[..., None]
        share, clear = sign * c * alpha, 1 - np.sum(sign * c * alpha, 0)
    else:
        opacity = c * alpha
        behind = [np.broadcast_to(paper, (*c.shape[1:], 3))]
        for o, color in zip(opacity, colors, strict=True):
            behind.append(o[..., None] * color[:3] + (1 - o[..., None]) * behind[-1])
        through = [np.ones(c.shape[1:])]
        for o in opacity[::-1]:
            through.append(through[-1] * (1 - o))
        clear, front = through[-1], np.stack(through[-2::-1])
        jump = front[..., None] * (colors[:, None, None, :3] - np.stack(behind[:-1]))
        share = front * opacity
    image = np.einsum("nhw,nc->hwc", share, colors[:, :3]) + clear[..., None] * paper
    by_corners = dc[..., None] * (alpha[..., None] * jump)[:, None, None]
    by_alpha = c[..., None] * jump
    assert bends is not None
    return Jacobian(image, by_corners, share, by_alpha, clear, bends)
