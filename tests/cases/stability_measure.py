"""Errors of the package in float32 against float64, for each case of `stability_cases`."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import softras2d as sr

from ..oracles import stability_truth
from .products import float_leaves, products, stack
from .stability_cases import CASES, MODES, SIZE, WIDEST, Case

BACKGROUND = np.array([0.9, 0.6, 0.3], np.float32)

ROUNDING = 4 * float(np.spacing(np.float32(SIZE)))
"""A few roundings of a coordinate on the canvas, in pixels."""


class Errors(NamedTuple):
    """Greatest error of the image, of J^T w, of J v and of J^T J v, and what was compared.

    Errors are relative to the greatest true number or to 1. They are infinite if a number is not
    finite. `compared` is the share of pixels whose derivative is known, and so compared.
    """

    value: float
    gradient: float
    jvp: float
    gauss_newton: float
    compared: float

    def within(self, limits: tuple[float, float]) -> bool:
        value, product = limits
        return self.value <= value and max(self[1:4]) <= product


class Numbers(NamedTuple):
    """An image and the products with its Jacobian, as NumPy arrays.

    - `gradient`, `gauss_newton`: a tuple of corners, colours and background.
    """

    image: np.ndarray
    gradient: tuple[np.ndarray, ...]
    jvp: np.ndarray
    gauss_newton: tuple[np.ndarray, ...]


def directions(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A seeded direction of corners `[count, 3, 2]`, RGBA `[count, 4]` and background `[3]`."""
    rng = np.random.default_rng(5)
    return rng.normal(size=(count, 3, 2)), rng.normal(size=(count, 4)), rng.normal(size=3)


def weight_of(shape: tuple[int, ...]) -> np.ndarray:
    return np.random.default_rng(6).normal(size=shape)


def scene_of(case: Case, mode: str, dtype: Any) -> sr.Scene:
    """The scene of a case; infinite and NaN coordinates become 0."""
    channels = 3 if mode == "hard" else 4
    return sr.Scene.from_soup(
        np.nan_to_num(case.corners, nan=0, posinf=0, neginf=0).astype(dtype),
        case.colors[:, :channels].astype(dtype),
        background=BACKGROUND.astype(dtype),
    )


def from_package(
    case: Case, mode: str, compared: np.ndarray, dtype: Any = np.float32, shift: int = 0
) -> Numbers:
    """The image and products that the package computes.

    - `compared`: the pixels `[size, size]` that count in products with J^T.
    - `shift`: how far the scene and the plan's origin are moved along both axes, in pixels.
    """
    scene, coverage, widest = scene_of(case, mode, dtype), MODES[mode], None
    if isinstance(coverage, sr.Soft):
        # A plan for any width, so that all cases share one program.
        coverage, widest = sr.Soft(case.softness), WIDEST
    moved = eqx.tree_at(lambda s: s.positions, scene, scene.positions + shift)
    size, origin = case.size, (shift, shift)
    plan = sr.plan(
        moved, height=size, width=size, coverage=coverage, origin=origin, max_width=widest
    )
    positions = jnp.asarray(case.corners.reshape(-1, 2), dtype) + shift
    scene = eqx.tree_at(lambda s: s.positions, scene, positions)
    corners, colors, background = directions(len(case.corners))
    direction = eqx.tree_at(
        lambda s: (s.positions, s.colors, s.background),
        float_leaves(scene),
        (
            jnp.asarray(corners.reshape(-1, 2), dtype),
            jnp.asarray(colors[:, None, : scene.colors.shape[2]], dtype),
            jnp.asarray(background, dtype),
        ),
    )
    weight = jnp.asarray(weight_of((size, size, 3)), dtype)
    results = products(scene, plan, stack([direction]), weight, jnp.asarray(compared, dtype))
    assert not results.overflow
    results = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), results)

    def split(moved: Any) -> tuple[np.ndarray, ...]:
        return moved.positions.reshape(-1, 3, 2), moved.colors[:, 0], moved.background

    normal = jax.tree.map(lambda leaf: leaf[0], results.normal)
    return Numbers(results.image, split(results.gradient), results.tangents[0], split(normal))


def reference(case: Case, mode: str) -> tuple[Numbers, np.ndarray]:
    """The true image and products, in float64 without the package.

    Also the pixels `[size, size]` whose derivatives are known, and so compared.
    """
    soft = isinstance(MODES[mode], sr.Soft)
    if soft:
        cover, smooth = (
            stability_truth.soft(case.size, case.size, case.softness),
            min(case.softness, 1.0),
        )
    else:
        cover, smooth = stability_truth.area(case.size, case.size), 1.0
    known = stability_truth.jacobian(
        cover,
        case.corners.astype(np.float64),
        case.colors.astype(np.float64),
        BACKGROUND.astype(np.float64),
        scale=stability_truth.Scale(ROUNDING, smooth, compares=soft),
        summed=mode == "sum",
    )
    compared = ~known.is_unknown
    weight = compared[..., None] * weight_of(known.image.shape)
    jvp = known.forward(*directions(len(case.corners)))
    normal = known.backward(compared[..., None] * jvp)
    return Numbers(known.image, known.backward(weight), jvp, normal), compared


def relative_error(actual: Any, expected: Any) -> float:
    """The greatest difference in any array of a result, over the greatest true number or 1."""
    pairs = list(zip(jax.tree.leaves(actual), jax.tree.leaves(expected), strict=True))
    if not all(np.isfinite(a).all() for a, _ in pairs):
        return np.inf
    scale = max(1.0, *(float(np.abs(b).max(initial=0)) for _, b in pairs))
    return max(float(np.abs(a - b).max(initial=0)) for a, b in pairs) / scale


def compare(actual: Numbers, expected: Numbers, compared: np.ndarray) -> Errors:
    """Errors of `actual` against `expected`; infinite if any number of `actual` is not finite.

    The jvp is compared only at the pixels `compared`.
    """
    mask = compared[..., None]
    jvp = np.where(mask | ~np.isfinite(actual.jvp), actual.jvp, 0)
    return Errors(
        relative_error(actual.image, expected.image),
        relative_error(actual.gradient, expected.gradient),
        relative_error(jvp, expected.jvp * mask),
        relative_error(actual.gauss_newton, expected.gauss_newton),
        float(compared.mean()),
    )


def measure(case: Case, mode: str) -> Errors:
    """Errors of float32: soft coverage and exact area are compared with `reference`.

    Hard mode is compared with itself in float64, which shows rounding errors alone. Other tests
    compare its image with an oracle in integers, and its derivatives with quadrature.
    """
    if mode in ("hard", "glass"):
        compared = np.ones((case.size, case.size), bool)
        with jax.enable_x64(True):
            expected = from_package(case, mode, compared, np.float64)
    else:
        expected, compared = reference(case, mode)
    return compare(from_package(case, mode, compared), expected, compared)


def moved(mode: str, shift: int, *, on_grid: bool) -> tuple[Errors, bool]:
    """Errors of an ordinary scene after moving it by `shift` pixels, and whether no bit changed.

    With `on_grid`, vertices lie at multiples of 1/64 pixel, which float32 represents up to 2^17
    pixels. Other vertices are rounded to float32 after the move, which shows in the errors.
    """
    case = CASES["ordinary"]()
    if on_grid:
        case = case._replace(corners=np.round(case.corners * 64) / 64)
    compared = np.ones((SIZE, SIZE), bool)
    still = from_package(case, mode, compared)
    away = from_package(case, mode, compared, shift=shift)
    pairs = zip(jax.tree.leaves(still), jax.tree.leaves(away), strict=True)
    return compare(away, still, compared), all(np.array_equal(a, b) for a, b in pairs)


LONG_MODES = ("hard", "soft", "area")

LONG_SIDE = 724
"""Side, in pixels, of a canvas with more than eight million samples at 16 per pixel."""


def long_sum(mode: str) -> tuple[float, float]:
    """Relative errors of the gradient of an image summed over all pixels, which adds many numbers.

    There is one error for the gradient with respect to colour and one for that with respect to
    corners. The scene is one triangle that covers about half of the canvas. Errors are relative to
    the norm of the true gradient, which is known in closed form for exact area, and from NumPy for
    soft coverage. For hard samples, the true gradient with respect to colour is a count of samples,
    and that with respect to corners comes from the package in float64.
    """
    corners = np.array([(9.25, 21.5), (711.75, 84.25), (301.5, 705.25)])
    color, background = np.array([[0.8, 0.1, 0.3]]), np.ones(3)
    coverage = {"hard": sr.Hard(16), "soft": sr.Soft(1.0), "area": sr.Area()}[mode]

    def by_package(dtype: Any) -> tuple[np.ndarray, np.ndarray]:
        scene = sr.Scene.from_soup(corners[None].astype(dtype), color, background=background)
        plan = sr.plan(scene, height=LONG_SIDE, width=LONG_SIDE, coverage=coverage)
        direction = jax.tree.map(jnp.zeros_like, float_leaves(scene))
        ones = jnp.ones((LONG_SIDE, LONG_SIDE, 3), dtype)
        result = products(scene, plan, stack([direction]), ones, ones[..., 0])
        assert not result.overflow
        gradient = result.gradient
        return np.asarray(gradient.colors, np.float64).ravel(), np.asarray(
            gradient.positions, np.float64
        )

    jump = float((color[0] - background).sum())
    (ax, ay), (bx, by) = corners[1] - corners[0], corners[2] - corners[0]
    by_color_true = 0.5 * (ax * by - ay * bx)
    ahead, behind = np.roll(corners, -1, 0), np.roll(corners, 1, 0)
    by_corners_true = 0.5 * np.stack([ahead[:, 1] - behind[:, 1], behind[:, 0] - ahead[:, 0]], 1)
    if mode == "soft":
        cover, step = stability_truth.soft(LONG_SIDE, LONG_SIDE, 1.0), 1e-5
        by_color_true = cover(corners).sum()
        by_corners_true = stability_truth.derivatives(cover, corners, step).sum((2, 3))
    by_corners_true = jump * by_corners_true
    if mode == "hard":
        y, x = (np.mgrid[: 4 * LONG_SIDE, : 4 * LONG_SIDE] + 0.5) / 4
        inside = stability_truth.distance(corners, x, y) >= 0
        by_color_true = inside.sum() / 16
        with jax.enable_x64(True):
            by_corners_true = by_package(np.float64)[1]
    by_color, by_corners = by_package(np.float32)
    bias = np.linalg.norm(by_color - by_color_true) / np.linalg.norm([by_color_true] * 3)
    return float(bias), float(
        np.linalg.norm(by_corners - by_corners_true) / np.linalg.norm(by_corners_true)
    )
