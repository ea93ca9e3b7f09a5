"""A linear map with a given transpose is right under every transformation of JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softras2d.numerics.linear_map import linear_map


def _forward(fixed, x):
    matrix, scale = fixed
    return scale * (matrix @ x)


def _backward(fixed, y):
    matrix, scale = fixed
    return scale * (matrix.T @ y)


MAP = linear_map(_forward, _backward)


@pytest.fixture
def case():
    rng = np.random.default_rng(0)
    matrix, x, y = rng.normal(size=(3, 4)), rng.normal(size=4), rng.normal(size=3)
    return (
        jnp.asarray(matrix, jnp.float32),
        jnp.asarray(x, jnp.float32),
        jnp.asarray(y, jnp.float32),
    )


def test_jvp_and_transpose_are_the_given_functions(case):
    matrix, x, y = case
    fixed = (matrix, jnp.float32(2.0))
    value, jvp = jax.linearize(lambda x: MAP(fixed, x), x)
    np.testing.assert_allclose(value, 2 * matrix @ x, rtol=1e-6)
    np.testing.assert_allclose(jvp(x), value, rtol=1e-6)
    (transposed,) = jax.linear_transpose(lambda x: MAP(fixed, x), x)(y)
    np.testing.assert_allclose(transposed, 2 * matrix.T @ y, rtol=1e-6)
    assert "transpose" not in str(jax.make_jaxpr(jax.grad(lambda x: MAP(fixed, x)[0]))(x))


def test_fixed_arguments_have_derivatives_too(case):
    matrix, x, y = case

    def with_map(matrix, scale, x):
        return y @ MAP((matrix, scale), x) ** 2

    def plain(matrix, scale, x):
        return y @ _forward((matrix, scale), x) ** 2

    arguments = (matrix, jnp.float32(1.5), x)
    for actual, expected in zip(
        jax.jit(jax.jacfwd(with_map, (0, 1, 2)))(*arguments),
        jax.jit(jax.jacfwd(plain, (0, 1, 2)))(*arguments),
        strict=True,
    ):
        np.testing.assert_allclose(actual, expected, rtol=1e-5)
    np.testing.assert_allclose(
        jax.hessian(with_map, 2)(*arguments), jax.hessian(plain, 2)(*arguments), rtol=1e-5
    )


@pytest.mark.parametrize("axes", [(None, 0), (0, None), (0, 0), (1, 1)])
def test_vmap_equals_a_loop(case, axes):
    matrix, x, _ = case
    factor = jnp.arange(1.0, 4.0)
    batch = [
        entry if axis is None else jnp.stack([f * entry for f in factor], axis)
        for entry, axis in zip((matrix, x), axes, strict=True)
    ]

    def gradient(matrix, x):
        return jax.grad(lambda x: jnp.sum(MAP((matrix, jnp.float32(1.0)), x) ** 2))(x)

    of_batch = jax.vmap(gradient, axes)(*batch)
    for k in range(3):
        entries = [
            entry if axis is None else jnp.take(entry, k, axis)
            for entry, axis in zip(batch, axes, strict=True)
        ]
        np.testing.assert_allclose(of_batch[k], gradient(*entries), rtol=1e-5)
