"""Derivatives of a render with respect to all floating-point arrays and the level-of-detail bias.

Each structure of a scene is compiled into one forward and one backward program, whichever arrays a
test varies.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import softras2d as sr

MOVING = ("colors", "background", "uv", "inverse_w", "textures")
"""Fields in which the image is continuous if textures are interpolated.

It jumps as positions or depths change.
"""


def _split(scene: sr.Scene, plan: sr.Plan) -> tuple[Any, Any]:
    return eqx.partition((scene, plan.filter.lod_bias), eqx.is_inexact_array)


def _image(floats: Any, rest: Any, plan: sr.Plan) -> Any:
    scene, bias = eqx.combine(floats, rest)
    biased = eqx.tree_at(lambda p: p.filter.lod_bias, plan, bias)
    return sr.render_checked(scene, biased)[0]


@eqx.filter_jit
def forward(scene: sr.Scene, plan: sr.Plan, direction: Any) -> tuple[Any, Any]:
    """The image and its tangent along `direction`, a result of `direction_of`."""
    floats, rest = _split(scene, plan)
    return jax.jvp(lambda floats: _image(floats, rest, plan), (floats,), (direction,))


@eqx.filter_jit
def backward(scene: sr.Scene, plan: sr.Plan, weight: Any) -> tuple[Any, Any]:
    """The cotangents of `(scene, lod_bias)` for an image cotangent `weight`."""
    floats, rest = _split(scene, plan)
    return jax.vjp(lambda floats: _image(floats, rest, plan), floats)[1](weight)[0]


def direction_of(
    scene: sr.Scene, plan: sr.Plan, seed: int = 0, names: tuple[str, ...] = MOVING, bias: float = 0
) -> Any:
    """A direction of `(scene, lod_bias)`: random in the fields `names`, `bias`, and else zero."""
    rng = np.random.default_rng(seed)
    floats, _ = _split(scene, plan)
    zero = jax.tree.map(jnp.zeros_like, floats)
    moved, _ = zero
    for name in names:
        field = getattr(moved, name)
        if field is not None:
            random = jax.tree.map(
                lambda leaf: jnp.asarray(rng.normal(size=leaf.shape), leaf.dtype), field
            )
            moved = eqx.tree_at(lambda s, name=name: getattr(s, name), moved, random)
    return moved, jnp.full_like(zero[1], bias)


def weight_of(image: Any, seed: int = 0) -> Any:
    """A seeded weight for each value of the image."""
    return jnp.asarray(np.random.default_rng(seed).normal(size=image.shape), image.dtype)


def stepped(scene: sr.Scene, plan: sr.Plan, direction: Any, step: float) -> Any:
    """The image after the scene moved by `step` along the direction.

    The bias does not move: it is in single precision, too coarse for small steps.
    """
    floats, rest = _split(scene, plan)
    moved = jax.tree.map(lambda leaf, d: leaf + step * d, floats[0], direction[0])
    moved_scene, _ = eqx.combine((moved, floats[1]), rest)
    return np.asarray(sr.render_checked(moved_scene, plan)[0])


def difference(scene: sr.Scene, plan: sr.Plan, direction: Any, step: float = 1e-6) -> np.ndarray:
    """The central difference of the image as the scene moves along the direction."""
    ends = [stepped(scene, plan, direction, sign * step) for sign in (1, -1)]
    return (ends[0] - ends[1]) / (2 * step)


def is_finite(tree: Any) -> bool:
    """Whether every number of a tree is finite."""
    return all(bool(np.isfinite(leaf).all()) for leaf in jax.tree.leaves(tree))


def is_finite_and_not_zero(tree: Any) -> bool:
    """Whether every number of a tree is finite, and some number differs from zero."""
    return is_finite(tree) and any(bool(np.any(leaf)) for leaf in jax.tree.leaves(tree))


def inner(first: Any, second: Any) -> float:
    """The inner product of two trees, in float64."""
    pairs = zip(jax.tree.leaves(first), jax.tree.leaves(second), strict=True)
    return sum(float(np.vdot(np.asarray(a, float), np.asarray(b, float))) for a, b in pairs)


def assert_near(
    actual: Any, expected: Any, tolerance: float = 2e-5, *, least: float = 1.0, name: str = ""
) -> None:
    """Assert that two trees are close, array by array.

    The tolerance is relative to the greatest absolute number of the expected array, or to `least`
    if that is greater.
    """
    for a, b in zip(jax.tree.leaves(actual), jax.tree.leaves(expected), strict=True):
        scale = max(least, float(np.abs(b).max(initial=0)))
        np.testing.assert_allclose(a, b, rtol=0, atol=tolerance * scale, err_msg=name)
