"""Derivatives satisfy the same contract for each coverage option and each of its inputs.

The jvp and the vjp agree, every number is finite, `jit` changes nothing, and derivatives that must
be zero are exactly zero. The options are listed in `cases/modes.py`. `test_transformations.py`
tests derivatives of batches.
"""

import functools
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import pytest

import softras2d as sr

from .cases.derivatives import assert_near, inner, is_finite, weight_of
from .cases.modes import (
    COUNT,
    HIDDEN,
    MODES,
    NO_AREA,
    OFF_CANVAS,
    RICHEST,
    SIZE,
    mode_input_pairs,
    plan_of,
    scene_of,
)
from .cases.products import Products, float_leaves, products, stack


def direction_of(scene: sr.Scene, name: str, seed: int) -> Any:
    """A seeded direction in one input, zero in the others."""
    rng = np.random.default_rng(seed)
    return eqx.tree_at(
        lambda s: getattr(s, name),
        jax.tree.map(jnp.zeros_like, float_leaves(scene)),
        jax.tree.map(
            lambda leaf: jnp.asarray(rng.normal(size=leaf.shape), leaf.dtype),
            getattr(float_leaves(scene), name),
        ),
    )


class Derivatives(NamedTuple):
    """A scene, a direction for each input, a weight of the image, and the products with them.

    `directions` and the tangents in `products` are in the order of `Mode.inputs`.
    """

    scene: sr.Scene
    plan: sr.Plan
    directions: Any
    weight: Any
    products: Products

    def by_input(self, name: str, mode: str) -> tuple[Any, Any, Any]:
        """One input's direction, the image's tangent along it, and the gradient of the input."""
        index = MODES[mode].inputs.index(name)
        direction = jax.tree.map(lambda leaf: leaf[index], getattr(self.directions, name))
        return direction, self.products.tangents[index], getattr(self.products.gradient, name)


def directions_and_weights(mode: str, scene: sr.Scene) -> tuple[Any, Any, Any]:
    """A direction for each input, stacked; a weight of the image; and 1 for each pixel."""
    directions = [direction_of(scene, name, seed) for seed, name in enumerate(MODES[mode].inputs)]
    shape = (SIZE, SIZE, scene.background.shape[0])
    dtype = scene.positions.dtype
    weight = weight_of(jax.ShapeDtypeStruct(shape, dtype), seed=99)
    return stack(directions), weight, jnp.ones(shape[:2], dtype)


@functools.cache
def derivatives_of(mode: str, dtype: type = np.float32) -> Derivatives:
    """The derivatives of a mode, computed once for all its inputs."""
    scene = scene_of(MODES[mode].effects, dtype)
    plan = plan_of(mode, scene)
    directions, weight, ones = directions_and_weights(mode, scene)
    return Derivatives(
        scene, plan, directions, weight, products(scene, plan, directions, weight, ones)
    )


def assert_adjoint(derivatives: Derivatives, name: str, mode: str, tolerance: float) -> None:
    """Assert that `w . J v` and `J^T w . v` agree, relative to the norms of `J^T w` and `v`."""
    direction, tangent, gradient = derivatives.by_input(name, mode)
    norm = (inner(gradient, gradient) * inner(direction, direction)) ** 0.5
    assert abs(inner(derivatives.weight, tangent) - inner(gradient, direction)) <= tolerance * norm


@pytest.mark.parametrize("mode, name", mode_input_pairs())
def test_jvp_and_vjp_agree(mode, name):
    derivatives = derivatives_of(mode)
    assert not derivatives.products.overflow
    assert_adjoint(derivatives, name, mode, 1e-5)
    # The tangent is not zero, except for inputs named in `zero`.
    assert (np.abs(derivatives.by_input(name, mode)[1]).max() > 1e-3) == (
        name not in MODES[mode].zero
    )


@pytest.mark.slow
@pytest.mark.parametrize("mode, name", mode_input_pairs(RICHEST))
def test_jvp_and_vjp_agree_in_float64(mode, name, float64):
    assert_adjoint(derivatives_of(mode, np.float64), name, mode, 1e-10)


@pytest.mark.parametrize("mode, name", mode_input_pairs())
def test_image_and_derivatives_are_finite(mode, name):
    derivatives = derivatives_of(mode)
    assert is_finite((derivatives.products.image, *derivatives.by_input(name, mode)))


@pytest.mark.parametrize("mode, name", mode_input_pairs())
def test_derivatives_by_what_cannot_matter_are_zero(mode, name):
    derivatives = derivatives_of(mode)
    _, tangent, gradient = derivatives.by_input(name, mode)
    if name in MODES[mode].zero:
        assert not np.asarray(tangent).any()
        assert not np.asarray(gradient).any()
    if name in ("background", "textures"):
        return
    per_vertex = name in ("positions", "depth", "inverse_w")
    gradient = np.asarray(gradient).reshape(COUNT, -1) if per_vertex else np.asarray(gradient)
    assert not gradient[OFF_CANVAS].any()
    if MODES[mode].hides:
        assert not gradient[HIDDEN].any()
    if name == "uv":
        assert not gradient[np.asarray(derivatives.scene.texture_index) < 0].any()


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["hard", "soft"])
def test_jit_changes_nothing(mode):
    """`jax.jvp` and `jax.vjp` without `jit` agree with `jax.linearize` under `jit`."""
    derivatives = derivatives_of(mode)
    floats, rest = eqx.partition(derivatives.scene, eqx.is_inexact_array)

    def image(floats):
        return sr.render_checked(eqx.combine(floats, rest), derivatives.plan)[0]

    image_without_jit, vjp = jax.vjp(image, floats)
    assert_near(image_without_jit, derivatives.products.image)
    assert_near(vjp(derivatives.weight)[0], derivatives.products.gradient)
    direction = jax.tree.map(lambda leaf: leaf.sum(0), derivatives.directions)
    tangent = jax.jvp(image, (floats,), (direction,))[1]
    assert_near(tangent, derivatives.products.tangents.sum(0))


def image_by_positions(derivatives: Derivatives):
    return lambda positions: sr.render_checked(
        replace(derivatives.scene, positions=positions), derivatives.plan
    )[0]


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["soft", "area"])
def test_hessian_vector_products_are_those_of_the_gradient(mode, float64):
    """Hessian-vector products are symmetric, and equal differences of gradients."""
    derivatives = derivatives_of(mode, np.float64)
    image = image_by_positions(derivatives)
    gradient = jax.grad(lambda positions: jnp.sum(derivatives.weight * image(positions) ** 2))
    hessian_product = jax.jit(lambda x, v: jax.jvp(gradient, (x,), (v,))[1])
    gradient = jax.jit(gradient)
    rng, positions = np.random.default_rng(3), derivatives.scene.positions
    # The derivative jumps at a triangle without area, which is left out.
    is_smooth = np.ones((COUNT, 3, 1))
    is_smooth[NO_AREA] = 0
    u, v = (jnp.asarray((is_smooth * rng.normal(size=(COUNT, 3, 2))).reshape(-1, 2)) for _ in "uv")
    product = hessian_product(positions, v)
    assert is_finite(product)
    mask = is_smooth.reshape(-1, 1)
    assert inner(u, product) == pytest.approx(
        inner(v, hessian_product(positions, u)), rel=1e-9, abs=1e-9
    )
    step = 1e-7
    difference = (gradient(positions + step * v) - gradient(positions - step * v)) / (2 * step)
    assert_near(mask * product, mask * difference, 1e-5)


@pytest.mark.slow
def test_lineax_operators_give_the_same_products():
    mode = "soft"
    derivatives = derivatives_of(mode)
    image = image_by_positions(derivatives)
    operator = lx.JacobianLinearOperator(lambda x, _: image(x), derivatives.scene.positions)
    direction, tangent, gradient = derivatives.by_input("positions", mode)
    assert_near(operator.mv(direction), tangent)
    assert_near(operator.T.mv(derivatives.weight), gradient)
