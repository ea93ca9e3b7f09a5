"""Numerically hard scenes with vertex attributes: corner colours, a texture, perspective, depth.

Each has six triangles on 16 x 16 pixels, some of which are hard to shade. Float32 is compared with
the package itself in float64, which shows rounding errors alone. Other tests compare derivatives
with finite differences.
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
"""Coverage options by name; `Area` has no depth."""

NOT_FINITE = 3
"""Index of the triangle with a NaN or infinite corner, in the cases that have one."""


TEXTURE_INDEX = np.arange(COUNT, dtype=np.int32) % 3 - 1
"""Texture index of each triangle, -1 for none."""


class Case(NamedTuple):
    """A hard scene, and the errors allowed in float32. All arrays are float32.

    - `corners`: `[6, 3, 2]` in pixels.
    - `colors`: straight RGBA `[6, 3, 4]`.
    - `uv`: `[6, 3, 2]`.
    - `depth`, `inverse_w`: `[6, 3]`.
    - `temperature`: of blending by depth, in units of depth.
    - `modes`: the modes that draw the case.
    - `limits`: greatest allowed error of the image, and of the gradient, jvp and Gauss-Newton
      product with respect to each input, relative to the greatest true number or to 1.
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
    """Ordinary triangles, up to three of which are replaced by `hard` ones.

    `options`: other fields of `Case`.
    """
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
    """Ordinary triangles, with one coordinate of one corner set to `value`."""
    case = with_attributes()
    case.corners[NOT_FINITE, 1, 0] = value
    return case


def near_and_far_corners() -> Case:
    """Ordinary triangles with corners near the eye and far from it: `1 / w` is 1e-3 to 1e3."""
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
    # A point of a triangle without area has several colours, and rounding decides which is used.
    "without area": lambda: with_attributes(
        [[(5.3, 6.1)] * 3, [(2, 2), (6, 4), (12, 7)], [(4.5, 1), (4.5, 13), (4.5, 7)]],
        limits=(0.1, 2.0),
    ),
    "small": lambda: with_attributes([[(7.3, 5.2), (7.302, 5.201), (7.3007, 5.2018)]]),
    "slivers of 1e3": lambda: with_slivers(1e3)._replace(limits=(1e-5, 2e-4)),
    # The two long sides are a rounding apart, so rounding decides which of them is nearer, and
    # where between them a point lies.
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
    """The scene of a case with every effect that the mode draws; infinity and NaN become 0."""
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
    """The scene, and a plan that was made with 0 in place of infinity and NaN."""
    scene, coverage = scene_of(case, mode, dtype), MODES[mode]
    if isinstance(coverage, sr.Soft):
        coverage = sr.Soft(coverage.width, temperature=case.temperature)
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=coverage)
    positions = jnp.asarray(case.corners.reshape(-1, 2), dtype)
    return eqx.tree_at(lambda s: s.positions, scene, positions), plan


def solve(case: Case, mode: str, dtype: Any = np.float32) -> dict[str, Any]:
    """Image, gradient, jvp and Gauss-Newton product for all inputs, named as in `Errors`."""
    scene, plan = scene_and_plan(case, mode, dtype)
    rng = np.random.default_rng(5)
    direction = jax.tree.map(
        lambda leaf: jnp.asarray(rng.normal(size=leaf.shape), leaf.dtype), float_leaves(scene)
    )
    # Colours are divided by 1 / w, so a direction changes 1 / w in proportion to its value.
    direction = eqx.tree_at(lambda d: d.inverse_w, direction, direction.inverse_w * scene.inverse_w)
    weight = jnp.asarray(rng.normal(size=(SIZE, SIZE, 3)), dtype)
    result = products(scene, plan, stack([direction]), weight, jnp.ones((SIZE, SIZE), dtype))
    assert not result.overflow
    normal = jax.tree.map(lambda leaf: leaf[0], result.normal)
    numbers = (result.image, result.gradient, result.tangents[0], normal)
    in_float64 = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), numbers)
    return dict(zip(("value", "gradient", "jvp", "gauss_newton"), in_float64, strict=True))


def measure(case: Case, mode: str) -> Errors:
    """Greatest errors of float32 against float64 over all inputs.

    Errors are relative to the numbers of the same input, so that an input with large numbers does
    not conceal the errors of the others.
    """
    with jax.enable_x64(True):
        expected_numbers = solve(case, mode, np.float64)
    numbers = solve(case, mode)

    def worst(name: str) -> float:
        pairs = zip(
            jax.tree.leaves(numbers[name]), jax.tree.leaves(expected_numbers[name]), strict=True
        )
        return max(relative_error(actual, expected) for actual, expected in pairs)

    return Errors(*(worst(name) for name in numbers), compared=1.0)
