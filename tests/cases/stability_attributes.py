"""Hard scenes whose triangles carry something: corner colours, a texture, perspective, depth.

Six triangles on 16 x 16 pixels again; in each case some of them are hard to shade. The truth is the
package in float64, which shows roundings alone: its slopes are held to differences elsewhere.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import softras2d as sr

from .products import moving, products, stack
from .stability_cases import COUNT, SIZE, ordinary, sliver, tints
from .stability_measure import Errors, error

MODES: dict[str, sr.Soft | sr.Area] = {"soft": sr.Soft(1.0, temperature=0.3), "area": sr.Area()}
"""`Area` has no depth."""

WILD = 3
"""The triangle with a corner that is no number, where there is one."""


TEXTURED = np.arange(COUNT, dtype=np.int32) % 3 - 1
"""Which texture each triangle has, -1 for none."""


class Case(NamedTuple):
    """Per corner: `corners` `[6, 3, 2]`, RGBA `[6, 3, 4]`, `uv`, `depth`, `inverse_w`, float32.

    - `temperature`: of the mixture by depth; `modes`: which draw it.
    - `limits`: stated errors of the value, and of the three products, each input by itself,
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


def carrying(hard: list | None = None, **options: Any) -> Case:
    """Ordinary triangles, and hard ones in the place of some."""
    rng = np.random.default_rng(4)
    corners = ordinary()
    given = np.asarray([] if hard is None else hard, np.float32).reshape(-1, 3, 2)
    corners[[1, 3, 5][: len(given)]] = given
    colors = np.repeat(tints()[:, None], 3, axis=1)
    colors[..., :3] = rng.random((COUNT, 3, 3), np.float32)
    return Case(
        corners,
        colors,
        uv=rng.uniform(0.1, 0.9, (COUNT, 3, 2)).astype(np.float32),
        depth=rng.random((COUNT, 3)).astype(np.float32),
        inverse_w=rng.uniform(0.5, 1.5, (COUNT, 3)).astype(np.float32),
    )._replace(**options)


def wild(value: float) -> Case:
    case = carrying()
    case.corners[WILD, 1, 0] = value
    return case


def steep() -> Case:
    """Corners next to the eye and far from it: `1 / w` from a thousandth to a thousand."""
    powers = np.random.default_rng(7).uniform(-3, 3, (COUNT, 3))
    powers[0] = -3, 0, 3
    return carrying(inverse_w=(10**powers).astype(np.float32), limits=(5e-6, 5e-4))


def slivers(aspect: float) -> Case:
    return carrying(
        [
            sliver((1.3, 2.1), (13.2, 9.7), aspect),
            sliver((2.2, 12.4), (14.1, 12.9), aspect),
            sliver((6.1, 1.2), (5.7, 14.9), aspect),
        ]
    )


CASES: dict[str, Callable[[], Case]] = {
    "ordinary": carrying,
    # One place of a triangle without area has several colours: a rounding chooses.
    "without area": lambda: carrying(
        [[(5.3, 6.1)] * 3, [(2, 2), (6, 4), (12, 7)], [(4.5, 1), (4.5, 13), (4.5, 7)]],
        limits=(0.1, 2.0),
    ),
    "small": lambda: carrying([[(7.3, 5.2), (7.302, 5.201), (7.3007, 5.2018)]]),
    "slivers of 1e3": lambda: slivers(1e3)._replace(limits=(1e-5, 2e-4)),
    # Their sides are a rounding apart, and it says which is nearer, or where between them.
    "slivers of 1e6": lambda: slivers(1e6)._replace(limits=(1e-2, 1.0)),
    "canvas times 1e4": lambda: carrying(
        [[(7.3 - 6.1e4, 8.6 - 4.9e4), (7.3 + 6.1e4, 8.6 + 4.9e4), (-7.7e4, 8.3e4)]],
        limits=(5e-6, 5e-4),
    ),
    "1 / w 1e-3 to 1e3": steep,
    "all at one depth": lambda: carrying(depth=np.ones((COUNT, 3), np.float32), modes=("soft",)),
    "temperature 1e-3": lambda: carrying(temperature=1e-3, modes=("soft",), limits=(5e-6, 1e-3)),
    "NaN": lambda: wild(np.nan),
    "infinity": lambda: wild(np.inf),
}


def scene_of(case: Case, mode: str, dtype: Any) -> sr.Scene:
    """With every effect that the mode draws; corners that are no numbers are 0."""
    rng = np.random.default_rng(8)
    return sr.Scene.from_soup(
        np.nan_to_num(case.corners, nan=0, posinf=0, neginf=0).astype(dtype),
        case.colors.astype(dtype),
        background=[0.9, 0.6, 0.3],
        uv=case.uv.astype(dtype),
        texture_index=TEXTURED,
        textures=sr.TexturePyramid.build(
            [rng.random((8, 8, 3)).astype(np.float32).astype(dtype) for _ in "ab"]
        ),
        depth=case.depth.astype(dtype) if mode == "soft" else None,
        inverse_w=case.inverse_w.astype(dtype),
    )


def planned(case: Case, mode: str, dtype: Any = np.float32) -> tuple[sr.Scene, sr.Plan]:
    """Planned for corners that are finite; the others are put back in."""
    scene, coverage = scene_of(case, mode, dtype), MODES[mode]
    if isinstance(coverage, sr.Soft):
        coverage = sr.Soft(coverage.width, temperature=case.temperature)
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=coverage)
    positions = jnp.asarray(case.corners.reshape(-1, 2), dtype)
    return eqx.tree_at(lambda s: s.positions, scene, positions), plan


def solve(case: Case, mode: str, dtype: Any = np.float32) -> dict[str, Any]:
    """Image, gradient, jvp and Gauss-Newton product by every input, as `Errors` names them."""
    scene, plan = planned(case, mode, dtype)
    rng = np.random.default_rng(5)
    direction = jax.tree.map(
        lambda leaf: jnp.asarray(rng.normal(size=leaf.shape), leaf.dtype), moving(scene)
    )
    # What divides changes by a part of itself.
    direction = eqx.tree_at(lambda d: d.inverse_w, direction, direction.inverse_w * scene.inverse_w)
    weight = jnp.asarray(rng.normal(size=(SIZE, SIZE, 3)), dtype)
    found = products(scene, plan, stack([direction]), weight, jnp.ones((SIZE, SIZE), dtype))
    assert not found.overflow
    normal = jax.tree.map(lambda leaf: leaf[0], found.normal)
    numbers = (found.image, found.gradient, found.tangents[0], normal)
    held = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), numbers)
    return dict(zip(("value", "gradient", "jvp", "gauss_newton"), held, strict=True))


def measure(case: Case, mode: str) -> Errors:
    """float32 against float64, each input by itself."""
    with jax.enable_x64(True):
        true = solve(case, mode, np.float64)
    found = solve(case, mode)

    def worst(name: str) -> float:
        pairs = zip(jax.tree.leaves(found[name]), jax.tree.leaves(true[name]), strict=True)
        return max(error(own, known) for own, known in pairs)

    return Errors(*(worst(name) for name in found), kept=1.0)
