"""A function applied block by block gives the same result as applied to all entries at once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softras2d.numerics.blocks import map_blocks


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
