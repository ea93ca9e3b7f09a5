"""Hard scenes with vertex attributes: corner colours, a texture, perspective, depth.

Six triangles on 16 x 16 pixels; in each case some of them are hard to shade. The reference is the
package in float64, which shows rounding errors alone: its derivatives are tested against
differences elsewhere.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import softras2d as sr

from .products import float_leaves, products, stack
from .stability_cases import COUNT, SIZE, ordinary_triangles, sliver, translucent_colors
from .stability_measure import Errors, relative_error

MODES: dict[str, sr.Soft | sr.Area] = {"soft": sr.Soft(1.0, temperature=0.3), "area": sr.Area()}
"""The coverages; `Area` has no depth."""

NOT_FINITE = 3
"""Index of the triangle with a NaN or infinite corner, in the cases that have one."""


TEXTURE_INDEX = np.arange(COUNT, dtype=np.int32) % 3 - 1
"""Index of the texture of each triangle, -1 for none."""


class Case(NamedTuple):
    """Corners `[6, 3, 2]`, and per corner RGBA `[6, 3, 4]`, uv, depth and `1 / w`, float32.

    - `temperature`: how softly depth is blended; `modes`: the modes that draw the case.
    - `limits`: stated errors of the value, and of the three products, for each input separately,
      relative to the greatest number or to 1.
    """

    corners: np.ndarray
    colors: np.ndarray
    uv: np.ndarray
    depth: np.ndarray
    inverse_w: np.ndarray
    temperature: float = 0.3
    modes: tuple[str, ...] = tuple(MODES)
    limits: tuple[float, float] = (5e-6, 5e-5)


def with_attributes(hard: list | None = None, **options: Any) -> Case:
    """Ordinary triangles, up to three of them replaced by `hard` ones; `options`: other fields."""
    rng = np.random.default_rng(4)
    corners = ordinary_triangles()
    hard_corners = np.asarray([] if hard is None else hard, np.float32).reshape(-1, 3, 2)
    corners[[1, 3, 5][: len(hard_corners)]] = hard_corners
    colors = np.repeat(translucent_colors()[:, None], 3, axis=1)
    colors[..., :3] = rng.random((COUNT, 3, 3), np.float32)
    return Case(
        corners,
        colors,
        uv=rng.uniform(0.1, 0.9, (COUNT, 3, 2)).astype(np.float32),
        depth=rng.random((COUNT, 3)).astype(np.float32),
        inverse_w=rng.uniform(0.5, 1.5, (COUNT, 3)).astype(np.float32),
    )._replace(**options)


def with_coordinate(value: float) -> Case:
    """Ordinary triangles, one coordinate of one corner set to `value`."""
    case = with_attributes()
    case.corners[NOT_FINITE, 1, 0] = value
    return case


def near_and_far_corners() -> Case:
    """Corners near the eye and far from it: `1 / w` from a thousandth to a thousand."""
    powers = np.random.default_rng(7).uniform(-3, 3, (COUNT, 3))
    powers[0] = -3, 0, 3
    return with_attributes(inverse_w=(10**powers).astype(np.float32), limits=(5e-6, 5e-4))


def with_slivers(aspect: float) -> Case:
    """Three slivers of the given aspect ratio among ordinary triangles."""
    return with_attributes(
        [
            sliver((1.3, 2.1), (13.2, 9.7), aspect),
            sliver((2.2, 12.4), (14.1, 12.9), aspect),
            sliver((6.1, 1.2), (5.7, 14.9), aspect),
        ]
    )


CASES: dict[str, Callable[[], Case]] = {
    "ordinary": with_attributes,
    # A point of a triangle without area has several colours: rounding decides which is used.
    "without area": lambda: with_attributes(
        [[(5.3, 6.1)] * 3, [(2, 2), (6, 4), (12, 7)], [(4.5, 1), (4.5, 13), (4.5, 7)]],
        limits=(0.1, 2.0),
    ),
    "small": lambda: with_attributes([[(7.3, 5.2), (7.302, 5.201), (7.3007, 5.2018)]]),
    "slivers of 1e3": lambda: with_slivers(1e3)._replace(limits=(1e-5, 2e-4)),
    # Their sides are a rounding apart: rounding decides which is nearer, or how far between them.
    "slivers of 1e6": lambda: with_slivers(1e6)._replace(limits=(1e-2, 1.0)),
    "canvas times 1e4": lambda: with_attributes(
        [[(7.3 - 6.1e4, 8.6 - 4.9e4), (7.3 + 6.1e4, 8.6 + 4.9e4), (-7.7e4, 8.3e4)]],
        limits=(5e-6, 5e-4),
    ),
    "1 / w 1e-3 to 1e3": near_and_far_corners,
    "all at one depth": lambda: with_attributes(
        depth=np.ones((COUNT, 3), np.float32), modes=("soft",)
    ),
    "temperature 1e-3": lambda: with_attributes(
        temperature=1e-3, modes=("soft",), limits=(5e-6, 1e-3)
    ),
    "NaN": lambda: with_coordinate(np.nan),
    "infinity": lambda: with_coordinate(np.inf),
}


def scene_of(case: Case, mode: str, dtype: Any) -> sr.Scene:
    """A scene with every effect that the mode draws; corners that are not finite are 0."""
    rng = np.random.default_rng(8)
    return sr.Scene.from_soup(
        np.nan_to_num(case.corners, nan=0, posinf=0, neginf=0).astype(dtype),
        case.colors.astype(dtype),
        background=[0.9, 0.6, 0.3],
        uv=case.uv.astype(dtype),
        texture_index=TEXTURE_INDEX,
        textures=sr.TexturePyramid.build(
            [rng.random((8, 8, 3)).astype(np.float32).astype(dtype) for _ in "ab"]
        ),
        depth=case.depth.astype(dtype) if mode == "soft" else None,
        inverse_w=case.inverse_w.astype(dtype),
    )


def scene_and_plan(case: Case, mode: str, dtype: Any = np.float32) -> tuple[sr.Scene, sr.Plan]:
    """The scene, and a plan made with 0 for the corners that are not finite."""
    scene, coverage = scene_of(case, mode, dtype), MODES[mode]
    if isinstance(coverage, sr.Soft):
        coverage = sr.Soft(coverage.width, temperature=case.temperature)
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=coverage)
    positions = jnp.asarray(case.corners.reshape(-1, 2), dtype)
    return eqx.tree_at(lambda s: s.positions, scene, positions), plan


def solve(case: Case, mode: str, dtype: Any = np.float32) -> dict[str, Any]:
    """Image, gradient, jvp and Gauss-Newton product by every input, under the names of `Errors`."""
    scene, plan = scene_and_plan(case, mode, dtype)
    rng = np.random.default_rng(5)
    direction = jax.tree.map(
        lambda leaf: jnp.asarray(rng.normal(size=leaf.shape), leaf.dtype), float_leaves(scene)
    )
    # A relative change of 1 / w, by which colours are divided.
    direction = eqx.tree_at(lambda d: d.inverse_w, direction, direction.inverse_w * scene.inverse_w)
    weight = jnp.asarray(rng.normal(size=(SIZE, SIZE, 3)), dtype)
    result = products(scene, plan, stack([direction]), weight, jnp.ones((SIZE, SIZE), dtype))
    assert not result.overflow
    normal = jax.tree.map(lambda leaf: leaf[0], result.normal)
    numbers = (result.image, result.gradient, result.tangents[0], normal)
    in_float64 = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), numbers)
    return dict(zip(("value", "gradient", "jvp", "gauss_newton"), in_float64, strict=True))


def measure(case: Case, mode: str) -> Errors:
    """Errors of float32 against float64, each input separately."""
    with jax.enable_x64(True):
        expected_numbers = solve(case, mode, np.float64)
    numbers = solve(case, mode)

    def worst(name: str) -> float:
        pairs = zip(
            jax.tree.leaves(numbers[name]), jax.tree.leaves(expected_numbers[name]), strict=True
        )
        return max(relative_error(actual, expected) for actual, expected in pairs)

    return Errors(*(worst(name) for name in numbers), compared=1.0)
