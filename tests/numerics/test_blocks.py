"""A function applied block by block gives the same result as applied to all entries at once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softras2d.numerics.blocks import map_blocks, map_differentiable_blocks


def _squares(entries):
    x, y = entries
    return x * x, x[:, None] + y


@pytest.mark.parametrize("size", [4, 10, 16])
@pytest.mark.parametrize("used", [0, 5, 10, 99])
def test_blocks_have_the_results_of_all_entries_at_once(size, used):
    x, y = jnp.arange(10.0), jnp.arange(30.0).reshape(10, 3)
    results = jax.jit(lambda *entries: map_blocks(_squares, entries, jnp.asarray(used), size=size))
    compared = min(used, 10)
    for actual, expected in zip(results(x, y), _squares((x, y)), strict=True):
        np.testing.assert_array_equal(actual[:compared], expected[:compared])


def test_elements_of_a_batch_may_use_different_numbers_of_entries():
    x, used = jnp.arange(20.0).reshape(2, 10), jnp.asarray([3, 9])
    double = jax.vmap(lambda x, used: map_blocks(lambda x: 2 * x, x, used, size=4))
    actual = double(x, used)
    np.testing.assert_array_equal(actual[0, :3], 2 * x[0, :3])
    np.testing.assert_array_equal(actual[1, :9], 2 * x[1, :9])


def _cubes_of_used(entries):
    x, y, used = entries
    return jnp.where(used, x**3, 0.0), jnp.where(used[None], jnp.sin(x)[None] * y, 0.0)


def _differentiable(entries, used, size):
    return map_differentiable_blocks(_cubes_of_used, entries, used, size=size)


def _entries(used: int):
    x = jnp.linspace(-1.0, 2.0, 10)
    return x, jnp.stack([x + 1.0, x - 1.0, 2.0 * x]), jnp.arange(10) < used


@pytest.mark.parametrize("size", [3, 4, 5, 10, 16])
@pytest.mark.parametrize("used", [0, 5, 10, 99])
def test_differentiable_blocks_have_the_results_of_all_entries_at_once(size, used):
    entries = _entries(used)
    actual = jax.jit(lambda entries: _differentiable(entries, jnp.asarray(used), size))(entries)
    for result, expected in zip(actual, _cubes_of_used(entries), strict=True):
        assert result.shape == expected.shape
        np.testing.assert_allclose(result, expected, rtol=1e-6)


@pytest.mark.parametrize("used", [0, 5, 10])
def test_derivatives_of_blocks_are_those_of_all_entries_at_once(used):
    x, y, is_used = _entries(used)

    def loss(x, y, size):
        cubes, waves = _differentiable((x, y, is_used), jnp.asarray(used), size)
        return jnp.sum(cubes * jnp.arange(10.0)) + jnp.sum(waves**2)

    blocks, whole = (jax.grad(loss, argnums=(0, 1))(x, y, size) for size in (4, 99))
    for actual, expected in zip(blocks, whole, strict=True):
        np.testing.assert_allclose(actual, expected, rtol=1e-6)
    _, tangent = jax.jvp(lambda x: loss(x, y, 4), (x,), (jnp.ones(10),))
    np.testing.assert_allclose(tangent, jnp.sum(blocks[0]), rtol=1e-5, atol=1e-5)


def test_blocks_add_their_derivatives_with_respect_to_an_array_that_all_of_them_read():
    x, _, is_used = _entries(7)
    index = jnp.arange(10) % 4

    def loss(table, size):
        def read(entries):
            index, x, is_used = entries
            return jnp.where(is_used, table[index] ** 2 * x, 0.0)

        entries = index, x, is_used
        return jnp.sum(map_differentiable_blocks(read, entries, jnp.asarray(7), size=size))

    table = jnp.arange(1.0, 5.0)
    expected = np.zeros(4)
    np.add.at(expected, index[:7], 2 * np.asarray(table[index] * x)[:7])
    for size in (4, 99):
        np.testing.assert_allclose(jax.grad(loss)(table, size), expected, rtol=1e-6)
        _, tangent = jax.jvp(lambda table, size=size: loss(table, size), (table,), (table,))
        np.testing.assert_allclose(tangent, np.dot(expected, table), rtol=1e-6)


def test_batches_have_the_derivatives_of_their_elements():
    x, y, _ = _entries(0)
    used = jnp.asarray([2, 7])

    def total(x, used):
        entries = x, y, jnp.arange(10) < used
        return sum(jnp.sum(result) for result in _differentiable(entries, used, 4))

    batch = jnp.stack([x, x + 0.5])
    values, gradients = jax.vmap(jax.value_and_grad(total))(batch, used)
    for index in range(2):
        value, gradient = jax.value_and_grad(total)(batch[index], used[index])
        np.testing.assert_allclose(values[index], value, rtol=1e-6)
        np.testing.assert_allclose(gradients[index], gradient, rtol=1e-6)


def test_unused_differentiable_blocks_are_not_computed():
    """`1 / x` at the unused entries would be infinite."""
    x = jnp.concatenate([jnp.ones(4), jnp.zeros(8)])
    result = map_differentiable_blocks(lambda x: 1.0 / x, x, jnp.asarray(4), size=4)
    np.testing.assert_array_equal(result, x)
