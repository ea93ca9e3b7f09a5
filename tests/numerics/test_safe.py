"""Safe square root and division have finite values and derivatives at their singular points."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.test_util import check_grads

from softras2d.numerics import safe


def test_sqrt_is_zero_with_derivative_zero_up_to_zero():
    x = jnp.array([-1.0, -0.0, 0.0, 0.25, 4.0])
    np.testing.assert_array_equal(safe.sqrt(x), [0, 0, 0, 0.5, 2])
    derivative = jax.vmap(jax.grad(safe.sqrt))
    np.testing.assert_array_equal(derivative(x), [0, 0, 0, 1, 0.25])
    curvature = jax.vmap(jax.grad(jax.grad(safe.sqrt)))(x)
    np.testing.assert_allclose(curvature, [0, 0, 0, -2, -1 / 32])


def test_division_by_zero_is_zero_with_derivative_zero():
    top, bottom = jnp.array([1.0, 0.0, 3.0, 0.0]), jnp.array([0.0, 0.0, 2.0, 4.0])
    np.testing.assert_array_equal(safe.divide(top, bottom), [0, 0, 1.5, 0])
    derivatives = jax.vmap(jax.grad(safe.divide, argnums=(0, 1)))(top, bottom)
    np.testing.assert_array_equal(derivatives[0], [0, 0, 0.5, 0.25])
    np.testing.assert_array_equal(derivatives[1], [0, 0, -0.75, 0])


def test_derivatives_elsewhere_equal_differences(float64):
    x = np.array([0.5, 2.0])
    check_grads(jax.jit(safe.sqrt), (x,), order=2)
    check_grads(jax.jit(safe.divide), (x, x[::-1].copy()), order=2)
