"""An oracle for soft coverage, exact area, the images they give, and all derivatives.

It uses float64 NumPy and shares no code with the package. The derivative of coverage with respect
to a corner is a central difference, over a step far below every length in the scene. The image is
multilinear in coverages and colours, so its derivatives with respect to them follow in closed form
from the transmittance in front of a triangle and the colour behind it.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

Coverage = Callable[[np.ndarray], np.ndarray]
"""Maps the corners `[3, 2]` of a triangle, in pixels, to coverage `[height, width]` in 0..1."""


def centres(height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """The x and y of all pixel centres, `[height, width]` each."""
    y, x = np.mgrid[:height, :width] + 0.5
    return x, y


def oriented(corners: np.ndarray) -> tuple[np.ndarray, float]:
    """The corners in positive orientation, and the sign of the area before reordering."""
    (ax, ay), (bx, by) = corners[1] - corners[0], corners[2] - corners[0]
    sign = float(np.sign(ax * by - ay * bx))
    return (corners[[0, 2, 1]] if sign < 0 else corners), sign


def distance(corners: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Signed distance to the triangle, in pixels and positive inside.

    A triangle without area has no inside, so the distance is nowhere positive.
    """
    corners, sign = oriented(corners)
    least, inside = np.full(x.shape, np.inf), np.full(x.shape, sign != 0)
    for k in range(3):
        (px, py), (ex, ey) = corners[k], corners[(k + 1) % 3] - corners[k]
        wx, wy = x - px, y - py
        squared_length = ex * ex + ey * ey
        t = (
            np.clip((wx * ex + wy * ey) / squared_length, 0, 1)
            if squared_length > 0
            else np.zeros(x.shape)
        )
        least = np.minimum(least, np.hypot(wx - t * ex, wy - t * ey))
        inside &= ex * wy - ey * wx >= 0
    return np.where(inside, least, -least)


def soft(height: int, width: int, softness: float) -> Coverage:
    """Soft coverage with the logistic profile.

    The logistic function is clamped at arguments of -6 and 6 and rescaled to 0..1. Coverage is 0.9
    at `softness` / 2 pixels inside the edge.
    """
    x, y = centres(height, width)
    cut_value = 1 / (1 + math.exp(6))
    high = 0.9 - 0.8 * cut_value
    per_pixel = 2 * math.log(high / (1 - high)) / softness

    def cover(corners: np.ndarray) -> np.ndarray:
        z = np.clip(distance(corners, x, y) * per_pixel, -6, 6)
        return (1 / (1 + np.exp(-z)) - cut_value) / (1 - 2 * cut_value)

    return cover


def area(height: int, width: int) -> Coverage:
    """Coverage by exact area: the integral, over y, of the length of horizontal sections.

    Within a pixel the length is piecewise linear in y. It has kinks at the corners and where edges
    cross the sides of the pixel, so the midpoint rule between the kinks is exact.
    """
    x, y = (c[..., None] - 0.5 for c in centres(height, width))

    def cover(corners: np.ndarray) -> np.ndarray:
        sides = [(corners[k], corners[(k + 1) % 3]) for k in range(3)]
        breaks = [np.broadcast_to(y, x.shape), np.broadcast_to(y + 1, x.shape)]
        breaks += [np.full(x.shape, corner[1]) for corner in corners]
        for p, q in sides:
            run = q[0] - p[0]
            if run != 0:
                breaks += [
                    p[1] + (x + pixel_side - p[0]) * ((q[1] - p[1]) / run) for pixel_side in (0, 1)
                ]
        level = np.sort(np.clip(np.concatenate(breaks, -1), y, y + 1), -1)
        middle = 0.5 * (level[..., 1:] + level[..., :-1])
        left, right = np.full(middle.shape, np.inf), np.full(middle.shape, -np.inf)
        for p, q in sides:
            rise = q[1] - p[1]
            if rise == 0:
                continue
            cut = p[0] + (middle - p[1]) / rise * (q[0] - p[0])
            crosses = (middle >= min(p[1], q[1])) & (middle <= max(p[1], q[1]))
            left = np.where(crosses, np.minimum(left, cut), left)
            right = np.where(crosses, np.maximum(right, cut), right)
        length = np.clip(right, x, x + 1) - np.clip(left, x, x + 1)
        return np.sum(np.diff(level) * np.where(right > left, length, 0), -1)

    return cover


def derivatives(cover: Coverage, corners: np.ndarray, step: float) -> np.ndarray:
    """Central differences of coverage for each coordinate, `[3, 2, height, width]`."""
    differences = []
    for k, axis in np.ndindex(3, 2):
        change = np.zeros((3, 2))
        change[k, axis] = step
        differences.append((cover(corners + change) - cover(corners - change)) / (2 * step))
    return np.stack(differences).reshape(3, 2, *differences[0].shape)


class Scale(NamedTuple):
    """The lengths, in pixels, that decide how finely derivatives are measured.

    - `rounding`: uncertainty of the corners in float32.
    - `smooth`: the length over which derivatives change noticeably, apart from jumps.
    - `compares`: whether coverage depends on which edge is nearest, as soft coverage does.
    """

    rounding: float
    smooth: float
    compares: bool

    def for_triangle(self, corners: np.ndarray) -> tuple[float, float]:
        """The step of central differences, and how far `jumps_nearby` may move the corners."""
        sides = corners - np.roll(corners, 1, 0)
        (ax, ay), (bx, by) = sides[:2]
        longest = np.hypot(*sides.T).max()
        height = abs(ax * by - ay * bx) / longest if longest > 0 else 0.0
        if height == 0:
            return 1e-5 * self.smooth, self.rounding
        step = min(1e-5 * self.smooth, 1e-3 * height)
        return step, self.rounding if self.compares else min(self.rounding, 1e-2 * height)


def jumps_nearby(
    cover: Coverage, corners: np.ndarray, derivative: np.ndarray, scale: Scale
) -> np.ndarray:
    """Which pixels `[height, width]` have a derivative that jumps within a rounding of the corners.

    This happens where a vertex lies on the pixel centre, or two edges are equally near to it. No
    float32 program can know the derivative there.
    """
    rng = np.random.default_rng(0)
    step, rounding = scale.for_triangle(corners)
    scale_of_jumps = max(1.0, float(np.abs(derivative).max()))
    jumps = np.zeros(derivative.shape[2:], bool)
    for _ in range(6):
        perturbed = corners + rng.choice([-1.0, 1.0], (3, 2)) * rounding
        jump = np.abs(derivatives(cover, perturbed, step) - derivative).max((0, 1))
        jumps |= jump > 8 * rounding / scale.smooth * scale_of_jumps
    return jumps


class Jacobian(NamedTuple):
    """An image, and its derivatives with respect to the inputs of a scene of n flat triangles.

    - `image`: `[height, width, 3]`.
    - `corners`: derivative for each coordinate of each corner, `[n, 3, 2, height, width, 3]`.
    - `color`: derivative of each channel with respect to the same channel of a triangle's colour,
      `[n, height, width]`.
    - `alpha`: derivative with respect to each triangle's alpha, `[n, height, width, 3]`.
    - `background`: derivative of each channel with respect to the same channel of the background,
      `[height, width]`.
    - `is_unknown`: pixels whose derivative with respect to corners is not known,
      `[height, width]`.
    """

    image: np.ndarray
    corners: np.ndarray
    color: np.ndarray
    alpha: np.ndarray
    background: np.ndarray
    is_unknown: np.ndarray

    def forward(
        self, corners: np.ndarray, colors: np.ndarray, background: np.ndarray
    ) -> np.ndarray:
        """J v, for a direction of corners `[n, 3, 2]`, RGBA `[n, 4]` and background `[3]`."""
        total = np.einsum("nkahwc,nka->hwc", self.corners, corners)
        total += np.einsum("nhw,nc->hwc", self.color, colors[:, :3])
        total += np.einsum("nhwc,n->hwc", self.alpha, colors[:, 3])
        return total + self.background[..., None] * background

    def backward(self, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """J^T w for corners, RGBA and background, given image weights w `[height, width, 3]`."""
        corners = np.einsum("nkahwc,hwc->nka", self.corners, weight)
        color = np.einsum("nhw,hwc->nc", self.color, weight)
        alpha = np.einsum("nhwc,hwc->n", self.alpha, weight)
        return (
            corners,
            np.append(color, alpha[:, None], 1),
            np.einsum("hw,hwc->c", self.background, weight),
        )


def jacobian(
    cover: Coverage,
    corners: np.ndarray,
    colors: np.ndarray,
    background: np.ndarray,
    *,
    scale: Scale,
    summed: bool = False,
) -> Jacobian:
    """The image of triangles `[n, 3, 2]` in straight RGBA `[n, 4]`, and its derivatives.

    The triangles are composited "over" in draw order. With `summed` they are added up, each with
    the sign of its area. A triangle with a corner that is not finite covers nothing.
    """
    finite = np.all(np.isfinite(corners), axis=(1, 2))
    corners = np.where(finite[:, None, None], corners, 0.0)
    (ax, ay), (bx, by) = ((corners[:, k] - corners[:, 0]).T for k in (1, 2))
    doubled_area = ax * by - ay * bx
    signs, sign_of_sum = np.sign(doubled_area), -1.0 if doubled_area.sum() < 0 else 1.0
    coverages, gradients, is_unknown = [], [], None
    for triangle, is_drawn in zip(corners, finite, strict=True):
        coverages.append(cover(triangle) * is_drawn)
        gradients.append(derivatives(cover, triangle, scale.for_triangle(triangle)[0]) * is_drawn)
        jumps = jumps_nearby(cover, triangle, gradients[-1], scale) & is_drawn
        is_unknown = jumps if is_unknown is None else is_unknown | jumps
    coverage, gradient = np.stack(coverages), np.stack(gradients)
    alpha = colors[:, 3, None, None]
    if summed:
        sign = (signs * sign_of_sum)[:, None, None]
        jump = (colors[:, :3] - background)[:, None, None] * sign[..., None]
        contribution = sign * coverage * alpha
        transmittance = 1 - np.sum(contribution, 0)
    else:
        opacity = coverage * alpha
        behind = [np.broadcast_to(background, (*coverage.shape[1:], 3))]
        for layer, color in zip(opacity, colors, strict=True):
            behind.append(layer[..., None] * color[:3] + (1 - layer[..., None]) * behind[-1])
        transmittances = [np.ones(coverage.shape[1:])]
        for layer in opacity[::-1]:
            transmittances.append(transmittances[-1] * (1 - layer))
        transmittance, in_front = transmittances[-1], np.stack(transmittances[-2::-1])
        jump = in_front[..., None] * (colors[:, None, None, :3] - np.stack(behind[:-1]))
        contribution = in_front * opacity
    image = (
        np.einsum("nhw,nc->hwc", contribution, colors[:, :3])
        + transmittance[..., None] * background
    )
    by_corners = gradient[..., None] * (alpha[..., None] * jump)[:, None, None]
    by_alpha = coverage[..., None] * jump
    assert is_unknown is not None
    return Jacobian(image, by_corners, contribution, by_alpha, transmittance, is_unknown)
