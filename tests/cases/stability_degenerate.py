"""Triangles with little or no area, and limits on the size and mismatch of their derivatives.

Each degenerate triangle is drawn between two ordinary ones, on a canvas of 16 x 16 pixels.
`stability_measure` leaves out pixels whose derivative jumps within a rounding of the corners. These
include every pixel that a triangle without area touches. The checks here leave out no pixel.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import softras2d as sr

SIZE = 16
Coverage = sr.Hard | sr.Soft | sr.Area

DEGENERATE = 1
"""Index of the degenerate triangle among the three of a scene."""

WIDTHS = (1e-4, 0.1, 1.0, 100.0)
"""Widths of soft edges, in pixels."""

MODES: dict[str, tuple[Coverage, str]] = {
    "hard": (sr.Hard(16), ""),
    "hard, shaded": (sr.Hard(4), "gatd"),
    "soft logistic": (sr.Soft(), ""),
    "soft softras": (sr.Soft(profile="softras"), ""),
    "soft window": (sr.Soft(profile="window"), ""),
    "soft, shaded": (sr.Soft(temperature=0.3), "gatd"),
    "area": (sr.Area(), ""),
    "area, shaded": (sr.Area(), "gat"),
    "sum, shaded": (sr.Area("sum"), "ga"),
}
"""Coverage option and effects, as letters for `scene_of`, by name."""

GRADIENT_LIMIT = 4.0
"""Greatest `relative_gradient` allowed."""

MISMATCH_LIMIT = 2e-3
"""Greatest `mismatch` of jvp and vjp allowed.

The worst case is a triangle of a few roundings in size at a pixel centre. The direction from the
centre to it is known only to a rounding over a thousandth of a pixel.
"""


def _on_line(start: np.ndarray, end: np.ndarray, fraction: float) -> list[np.ndarray]:
    return [start, end, start + fraction * (end - start)]


def _lifted(height: float) -> Callable[[np.ndarray, np.ndarray], list[np.ndarray]]:
    """A builder of triangles whose third corner lies `height` pixels off the line of the others."""

    def build(start: np.ndarray, end: np.ndarray) -> list[np.ndarray]:
        direction = end - start
        normal = np.array([-direction[1], direction[0]]) / np.hypot(*direction)
        return [start, end, start + 0.4 * direction + height * normal]

    return build


def _one_rounding(start: np.ndarray, end: np.ndarray) -> list[np.ndarray]:
    start, end, third = np.asarray(_on_line(start, end, 0.5), np.float32)
    third[1] = np.nextafter(third[1], np.float32(np.inf))
    return [start, end, third]


def _tiny(size: float) -> Callable[[np.ndarray, np.ndarray], list[np.ndarray]]:
    return lambda start, end: [start, start + size * np.array([1.0, 0.2]), start + size * 0.7]


KINDS: dict[str, Callable[[np.ndarray, np.ndarray], list[np.ndarray]]] = {
    "two equal": lambda start, end: [start, start, end],
    "three equal": lambda start, end: [start] * 3,
    "third between": lambda start, end: _on_line(start, end, 0.4),
    "third outside": lambda start, end: _on_line(start, end, 1.75),
    "third at an end": lambda start, end: _on_line(start, end, 1.0),
    "off by one rounding": _one_rounding,
    **{f"off by {height:.0e} px": _lifted(height) for height in (1e-7, 1e-6, 1e-5, 1e-4, 1e-3)},
    **{f"tiny, {size:.0e} px": _tiny(size) for size in (1e-6, 1e-5, 1e-4, 1e-2)},
    "needle": _lifted(1e-2),
    "far": lambda start, end: _on_line(
        start - 997 * (end - start), end + 1013 * (end - start), 0.6
    ),
}
"""Builders of degenerate triangles by kind: from two points on the canvas to three corners."""

SEGMENTS = (
    # Through pixel centres: diagonal, vertical, horizontal, and with a slope of one half.
    ((0.0, 0.0), (10.0, 10.0)),
    ((4.5, 1.5), (4.5, 13.5)),
    ((2.5, 9.5), (12.5, 9.5)),
    ((1.5, 2.5), (13.5, 8.5)),
    # Along the sides of pixels.
    ((3.0, 8.0), (11.0, 8.0)),
)


def corners_of_kind(kind: str, *, random: int = 5) -> np.ndarray:
    """Triangles of a kind, float32 `[n, 3, 2]`: one on each of `SEGMENTS`, then `random` others."""
    rng = np.random.default_rng(11)
    ends = [*np.asarray(SEGMENTS), *rng.uniform(1, SIZE - 1, (random, 2, 2))]
    return np.asarray([KINDS[kind](*pair) for pair in ends], np.float32)


CROSSING = np.array([(-3.0, -2.0), (19.0, 18.0), (17.0, 19.0)], np.float32)

ORDINARY = np.array(
    [[(1.2, 2.1), (14.3, 4.4), (5.2, 13.6)], [(9.1, 1.3), (15.2, 11.7), (6.4, 8.8)]], np.float32
)


def scene_of(effects: str, *, depth: float = 1.0, color: float = 1.0) -> sr.Scene:
    """A scene of three triangles, with the effects that the letters in `effects` name.

    The letters are g for corner colours, a for alpha, d for depth and t for a texture. `depth` and
    `color` are the greatest values. `derive` replaces the triangle in the middle.
    """
    rng = np.random.default_rng(3)
    soup = np.stack([ORDINARY[0], CROSSING, ORDINARY[1]])
    shape = (3, 3 if "g" in effects else 1, 4 if "a" in effects else 3)
    colors = 0.2 + 0.7 * rng.random(shape)
    colors[..., :3] *= color
    more: dict[str, Any] = {}
    if "d" in effects:
        more["depth"] = (depth * rng.random((3, 3))).astype(np.float32)
    if "t" in effects:
        more["uv"] = rng.uniform(0.1, 0.9, (3, 3, 2)).astype(np.float32)
        more["texture_index"] = np.array([0, 0, -1], np.int32)
        more["textures"] = sr.TexturePyramid.build([rng.random((8, 8, 3)).astype(np.float32)])
    return sr.Scene.from_soup(
        soup, colors.astype(np.float32), background=np.array([0.9, 0.6, 0.3], np.float32), **more
    )


def plan_of(coverage: Coverage, effects: str) -> sr.Plan:
    """A plan for any degenerate triangle, made for triangles that all cross the canvas."""
    crossings = jnp.asarray(np.tile(CROSSING, (3, 1)), jnp.float32)
    scene = eqx.tree_at(lambda s: s.positions, scene_of(effects), crossings)
    widest = max(WIDTHS) if isinstance(coverage, sr.Soft) else None
    return sr.plan(scene, height=SIZE, width=SIZE, coverage=coverage, max_width=widest)


class Derivatives(NamedTuple):
    """The image, its jvp and its vjp with respect to the corners of the degenerate triangle.

    - `image`: `[SIZE, SIZE, 3]`.
    - `tangent`: J v along `VELOCITY`, `[SIZE, SIZE, 3]`.
    - `gradient`: J^T w for `WEIGHT`, `[3, 2]`.
    """

    image: np.ndarray
    tangent: np.ndarray
    gradient: np.ndarray


VELOCITY = np.random.default_rng(5).normal(size=(3, 2)).astype(np.float32)
WEIGHT = np.random.default_rng(6).normal(size=(SIZE, SIZE, 3)).astype(np.float32)


BATCH = 42
"""Number of triangles that one compiled call draws, one after another."""


@eqx.filter_jit
def _derive(scene: sr.Scene, plan: sr.Plan, batch: Any, velocity: Any, weight: Any) -> Any:
    def draw(corners):
        positions = scene.positions.at[3 * DEGENERATE : 3 * DEGENERATE + 3].set(corners)
        moved = eqx.tree_at(lambda s: s.positions, scene, positions)
        return sr.render_checked(moved, plan)

    def derive_one(corners):
        image, jvp, overflow = jax.linearize(draw, corners, has_aux=True)
        return image, jvp(velocity), jax.linear_transpose(jvp, corners)(weight)[0], overflow

    return jax.lax.map(derive_one, batch)


def derive_each(scene: sr.Scene, plan: sr.Plan, corners: np.ndarray) -> list[Derivatives]:
    """Image, jvp and vjp for each degenerate triangle of `corners` `[n, 3, 2]`, one per scene."""
    derived = []
    for first in range(0, len(corners), BATCH):
        chunk = np.asarray(corners[first : first + BATCH], np.float32)
        padding = np.repeat(chunk[:1], BATCH - len(chunk), axis=0)
        batch = jnp.asarray(np.concatenate([chunk, padding]))
        *numbers, overflow = _derive(scene, plan, batch, VELOCITY, WEIGHT)
        assert not overflow.any()
        images, tangents, gradients = (np.asarray(entry, np.float64) for entry in numbers)
        derived += [Derivatives(images[k], tangents[k], gradients[k]) for k in range(len(chunk))]
    return derived


def derive(scene: sr.Scene, plan: sr.Plan, corners: np.ndarray) -> Derivatives:
    """Image, jvp and vjp of one degenerate triangle."""
    return derive_each(scene, plan, corners[None])[0]


def mismatch(derivatives: Derivatives) -> float:
    """The difference between `w . J v` and `J^T w . v`, relative to products of their norms."""
    forward = float((WEIGHT * derivatives.tangent).sum())
    backward = float((derivatives.gradient * VELOCITY).sum())
    scale = np.linalg.norm(WEIGHT) * np.linalg.norm(derivatives.tangent)
    scale += np.linalg.norm(derivatives.gradient) * np.linalg.norm(VELOCITY)
    return float(abs(forward - backward) / (scale if scale > 0 else 1.0))


def thickened(corners: np.ndarray) -> np.ndarray:
    """Six triangles `[6, 3, 2]` that are a pixel thick: one on either side of each edge.

    Their third corners lie a pixel from the middle of the edge. An edge shorter than a pixel is
    first lengthened to one pixel about its middle, along x if its length is 0.
    """
    triangles = []
    for k in range(3):
        start, end = corners[k].astype(np.float64), corners[(k + 1) % 3].astype(np.float64)
        direction, middle = end - start, 0.5 * (start + end)
        length = float(np.hypot(*direction))
        along = direction / length if length > 0 else np.array([1.0, 0.0])
        if length < 1:
            start, end = middle - 0.5 * along, middle + 0.5 * along
        normal = np.array([-along[1], along[0]])
        triangles += [[start, end, middle + sign * normal] for sign in (1, -1)]
    return np.asarray(triangles, np.float32)


def relative_gradient(derivatives: Derivatives, thick: list[Derivatives]) -> float:
    """The greatest entry of the gradient, over the greatest one of the `thickened` triangles."""
    reference = max(np.abs(derived.gradient).max() for derived in thick)
    largest = np.abs(derivatives.gradient).max()
    return float(largest / reference) if reference > 0 else float(np.inf if largest > 0 else 0)


def with_width(plan: sr.Plan, width: float) -> sr.Plan:
    return eqx.tree_at(lambda p: p.coverage.width, plan, jnp.float32(width))


SHADED_KINDS = (
    "two equal",
    "three equal",
    "third between",
    "off by one rounding",
    "off by 1e-06 px",
    "tiny, 1e-05 px",
    "needle",
)
"""Kinds that are drawn with effects, which take a hundred times as long as flat scenes."""


def measure(
    mode: str, *, widths: tuple[float, ...] = WIDTHS, random: int = 1
) -> list[dict[str, Any]]:
    """Measure the worst triangle of each kind: a row for each width and kind.

    In a row, `jvp_vjp` is the greatest `mismatch`, and `largest` the greatest `relative_gradient`.
    Scenes with effects are measured at one width, and for `SHADED_KINDS` alone.
    """
    coverage, effects = MODES[mode]
    scene, plan, rows = scene_of(effects), plan_of(coverage, effects), []
    kinds = SHADED_KINDS if effects else tuple(KINDS)
    if isinstance(coverage, sr.Hard):
        # The plan is for triangles within the guard band.
        kinds = tuple(kind for kind in kinds if kind != "far")
    if effects:
        widths = (1.0,)
    for width in widths if isinstance(coverage, sr.Soft) else (None,):
        plan_at_width = plan if width is None else with_width(plan, width)
        for kind in kinds:
            corners = corners_of_kind(kind, random=random)
            every = np.concatenate([corners, *map(thickened, corners)])
            every = derive_each(scene, plan_at_width, every)
            degenerate, thick = every[: len(corners)], every[len(corners) :]
            finite = all(np.isfinite(entry).all() for one in every for entry in one)
            worst = max(map(mismatch, degenerate))
            largest = max(
                relative_gradient(one, thick[6 * k : 6 * k + 6]) for k, one in enumerate(degenerate)
            )
            row = {"mode": mode, "width": width or "", "case": kind, "finite": finite}
            rows.append({**row, "jvp_vjp": worst, "largest": largest})
    return rows


def within(row: dict[str, Any]) -> bool:
    """Whether a row of `measure` is finite and within the limits."""
    return row["finite"] and row["jvp_vjp"] <= MISMATCH_LIMIT and row["largest"] <= GRADIENT_LIMIT


HEIGHTS = tuple(sign * 10.0**-power for power in range(8) for sign in (1, -1))


def collapse(mode: str, *, random: int = 3) -> list[dict[str, Any]]:
    """Measure how much changes when a triangle of height +-1e-7 pixels collapses to height 0.

    There is a row for each width and segment:

    - `value`: the greatest change of the image.
    - `gradient`, `jvp`: the greatest change of each, over its greatest number at a height of one
      pixel.
    - `largest`: the greatest gradient at any of `HEIGHTS`, over the same.
    """
    coverage, effects = MODES[mode]
    scene, plan, rows = scene_of(effects), plan_of(coverage, effects), []
    for width in WIDTHS[1:] if isinstance(coverage, sr.Soft) else (None,):
        plan_at_width = plan if width is None else with_width(plan, width)
        drawn = np.random.default_rng(12).uniform(3, SIZE - 3, (random, 2, 2))
        for case, (start, end) in enumerate([*np.asarray(BY_THE_ORIGIN), *drawn]):
            heights = (*HEIGHTS, 0.0)
            corners = np.asarray([_lifted(height)(start, end) for height in heights])
            by_height = dict(zip(heights, derive_each(scene, plan_at_width, corners), strict=True))
            flat, thick = by_height[0.0], (by_height[1.0], by_height[-1.0])

            def change(name: str, flat: Derivatives = flat, by_height: Any = by_height) -> float:
                at_zero = getattr(flat, name)
                return max(
                    float(np.abs(getattr(by_height[h], name) - at_zero).max())
                    for h in LEAST_HEIGHTS
                )

            size = max(np.abs(derivatives.gradient).max() for derivatives in thick)
            speed = max(np.abs(derivatives.tangent).max() for derivatives in thick)
            largest = max(np.abs(derivatives.gradient).max() for derivatives in by_height.values())
            where = "by the origin" if case < len(BY_THE_ORIGIN) else "anywhere"
            row = {"mode": mode, "width": width or "", "case": where, "value": change("image")}
            ratios = {"gradient": change("gradient") / size, "jvp": change("tangent") / speed}
            rows.append({**row, **ratios, "largest": float(largest / size)})
    return rows


LEAST_HEIGHTS = HEIGHTS[-2:]

BY_THE_ORIGIN = (
    ((2.2, 2.0**-6), (13.1, 2.0**-6)),
    ((2.0**-6, 14.3), (2.0**-6, 3.4)),
)
"""Segments at which float32 represents a height of 1e-7 px; elsewhere roundings reach 5e-7 px."""
