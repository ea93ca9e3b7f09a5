"""Errors of the package in float32 against float64, case by case."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import softras2d as sr

from ..oracles import stability_truth
from .products import moving, products, stack
from .stability_cases import CASES, MODES, SIZE, WIDEST, Case

PAPER = np.array([0.9, 0.6, 0.3], np.float32)

ROUNDING = 4 * float(np.spacing(np.float32(SIZE)))
"""A few roundings of a coordinate on the canvas, in pixels."""


class Errors(NamedTuple):
    """Greatest error of each, over the greatest true number or 1; infinite if one is not finite.

    `kept`: share of pixels whose derivative is known.
    """

    value: float
    gradient: float
    jvp: float
    gauss_newton: float
    kept: float

    def within(self, limits: tuple[float, float]) -> bool:
        value, product = limits
        return self.value <= value and max(self[1:4]) <= product


class Numbers(NamedTuple):
    """An image and its products, as numpy: position, colour and background parts of each."""

    image: np.ndarray
    gradient: tuple[np.ndarray, ...]
    jvp: np.ndarray
    gauss_newton: tuple[np.ndarray, ...]


def directions(count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """In which corners, RGBA and background move."""
    rng = np.random.default_rng(5)
    return rng.normal(size=(count, 3, 2)), rng.normal(size=(count, 4)), rng.normal(size=3)


def weight_of(shape: tuple[int, ...]) -> np.ndarray:
    return np.random.default_rng(6).normal(size=shape)


def scene_of(case: Case, mode: str, dtype: Any) -> sr.Scene:
    """Planned for triangles that are finite; the wild one is put back in."""
    channels = 3 if mode == "hard" else 4
    return sr.Scene.from_soup(
        np.nan_to_num(case.corners, nan=0, posinf=0, neginf=0).astype(dtype),
        case.colors[:, :channels].astype(dtype),
        background=PAPER.astype(dtype),
    )


def by_package(
    case: Case, mode: str, kept: np.ndarray, dtype: Any = np.float32, shift: int = 0
) -> Numbers:
    """What the package finds; `kept`: pixels that count in products with the transpose.

    `shift`: by which the scene and the plan's origin are moved, along both axes.
    """
    scene, coverage, widest = scene_of(case, mode, dtype), MODES[mode], None
    if isinstance(coverage, sr.Soft):
        # Room for any, so that all cases share one program.
        coverage, widest = sr.Soft(case.softness), WIDEST
    moved = eqx.tree_at(lambda s: s.positions, scene, scene.positions + shift)
    size, origin = case.size, (shift, shift)
    plan = sr.plan(
        moved, height=size, width=size, coverage=coverage, origin=origin, max_width=widest
    )
    positions = jnp.asarray(case.corners.reshape(-1, 2), dtype) + shift
    scene = eqx.tree_at(lambda s: s.positions, scene, positions)
    corners, colors, paper = directions(len(case.corners))
    direction = eqx.tree_at(
        lambda s: (s.positions, s.colors, s.background),
        moving(scene),
        (
            jnp.asarray(corners.reshape(-1, 2), dtype),
            jnp.asarray(colors[:, None, : scene.colors.shape[2]], dtype),
            jnp.asarray(paper, dtype),
        ),
    )
    weight = jnp.asarray(weight_of((size, size, 3)), dtype)
    found = products(scene, plan, stack([direction]), weight, jnp.asarray(kept, dtype))
    assert not found.overflow
    found = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), found)

    def split(moved: Any) -> tuple[np.ndarray, ...]:
        return moved.positions.reshape(-1, 3, 2), moved.colors[:, 0], moved.background

    normal = jax.tree.map(lambda leaf: leaf[0], found.normal)
    return Numbers(found.image, split(found.gradient), found.tangents[0], split(normal))


def by_hand(case: Case, mode: str) -> tuple[Numbers, np.ndarray]:
    """What is true, in float64 without the package; and the pixels where it is known."""
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
        PAPER.astype(np.float64),
        scale=stability_truth.Scale(ROUNDING, smooth, compares=soft),
        summed=mode == "sum",
    )
    kept = ~known.bends
    weight = kept[..., None] * weight_of(known.image.shape)
    jvp = known.forward(*directions(len(case.corners)))
    normal = known.backward(kept[..., None] * jvp)
    return Numbers(known.image, known.backward(weight), jvp, normal), kept


def error(found: Any, true: Any) -> float:
    """Over all parts of a result."""
    pairs = list(zip(jax.tree.leaves(found), jax.tree.leaves(true), strict=True))
    if not all(np.isfinite(a).all() for a, _ in pairs):
        return np.inf
    scale = max(1.0, *(float(np.abs(b).max(initial=0)) for _, b in pairs))
    return max(float(np.abs(a - b).max(initial=0)) for a, b in pairs) / scale


def compare(found: Numbers, true: Numbers, kept: np.ndarray) -> Errors:
    """All of what was found must be finite, but only what is known is compared."""
    there = kept[..., None]
    jvp = np.where(there | ~np.isfinite(found.jvp), found.jvp, 0)
    return Errors(
        error(found.image, true.image),
        error(found.gradient, true.gradient),
        error(jvp, true.jvp * there),
        error(found.gauss_newton, true.gauss_newton),
        float(kept.mean()),
    )


def measure(case: Case, mode: str) -> Errors:
    """Soft and exact coverage against a truth of their own.

    Hard mode against itself in float64, which shows roundings alone: its image is held to an
    oracle in integers and its slopes to a quadrature elsewhere.
    """
    if mode in ("hard", "glass"):
        kept = np.ones((case.size, case.size), bool)
        with jax.enable_x64(True):
            true = by_package(case, mode, kept, np.float64)
    else:
        true, kept = by_hand(case, mode)
    return compare(by_package(case, mode, kept), true, kept)


def moved(mode: str, shift: int, *, on_grid: bool) -> tuple[Errors, bool]:
    """Errors of an ordinary scene that lies `shift` pixels away, and whether no bit changed.

    `on_grid`: vertices at multiples of 1/64 pixel, which float32 holds up to 2^17 pixels; others
    are rounded to what it holds there, which shows in the errors.
    """
    case = CASES["ordinary"]()
    if on_grid:
        case = case._replace(corners=np.round(case.corners * 64) / 64)
    kept = np.ones((SIZE, SIZE), bool)
    still, away = by_package(case, mode, kept), by_package(case, mode, kept, shift=shift)
    pairs = zip(jax.tree.leaves(still), jax.tree.leaves(away), strict=True)
    return compare(away, still, kept), all(np.array_equal(a, b) for a, b in pairs)


LONG_MODES = ("hard", "soft", "area")

LONG = 724
"""Pixels along a canvas that has more than eight million samples at 16 a pixel."""


def long_sum(mode: str) -> tuple[float, float]:
    """Bias of the gradient of the whole image's sum: by the colour, and by the corners, of one
    triangle that covers half of the canvas.

    Relative to the norm of the true one: of areas in closed form; of soft coverage by numpy; of
    hard samples by counting them, and by the package in float64.
    """
    corners = np.array([(9.25, 21.5), (711.75, 84.25), (301.5, 705.25)])
    color, paper = np.array([[0.8, 0.1, 0.3]]), np.ones(3)
    coverage = {"hard": sr.Hard(16), "soft": sr.Soft(1.0), "area": sr.Area()}[mode]

    def by_package(dtype: Any) -> tuple[np.ndarray, np.ndarray]:
        scene = sr.Scene.from_soup(corners[None].astype(dtype), color, background=paper)
        plan = sr.plan(scene, height=LONG, width=LONG, coverage=coverage)
        direction = jax.tree.map(jnp.zeros_like, moving(scene))
        ones = jnp.ones((LONG, LONG, 3), dtype)
        found = products(scene, plan, stack([direction]), ones, ones[..., 0])
        assert not found.overflow
        gradient = found.gradient
        return np.asarray(gradient.colors, np.float64).ravel(), np.asarray(
            gradient.positions, np.float64
        )

    jump = float((color[0] - paper).sum())
    (ax, ay), (bx, by) = corners[1] - corners[0], corners[2] - corners[0]
    total = 0.5 * (ax * by - ay * bx)
    ahead, behind = np.roll(corners, -1, 0), np.roll(corners, 1, 0)
    slope = 0.5 * np.stack([ahead[:, 1] - behind[:, 1], behind[:, 0] - ahead[:, 0]], 1)
    if mode == "soft":
        cover, step = stability_truth.soft(LONG, LONG, 1.0), 1e-5
        total = cover(corners).sum()
        slope = stability_truth.slopes(cover, corners, step).sum((2, 3))
    slope = jump * slope
    if mode == "hard":
        y, x = (np.mgrid[: 4 * LONG, : 4 * LONG] + 0.5) / 4
        inside = stability_truth.distance(corners, x, y) >= 0
        total = inside.sum() / 16
        with jax.enable_x64(True):
            slope = by_package(np.float64)[1]
    by_color, by_corners = by_package(np.float32)
    bias = np.linalg.norm(by_color - total) / np.linalg.norm([total] * 3)
    return float(bias), float(np.linalg.norm(by_corners - slope) / np.linalg.norm(slope))
