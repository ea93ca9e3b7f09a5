"""Prefix scans equal NumPy's, at lengths around powers of two and around the limit of one row."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softras2d.numerics.prefix import cumulative_max, cumulative_sum


@pytest.mark.parametrize("length", [1, 2, 63, 64, 65, 4097, 2**15, 2**15 + 1, 2**18 + 1])
def test_scans_equal_numpy(length):
    values = np.random.default_rng(length).integers(0, 1000, length).astype(np.int32)
    np.testing.assert_array_equal(cumulative_sum(jnp.asarray(values)), np.cumsum(values))
    maxima = np.maximum.accumulate(values)
    np.testing.assert_array_equal(cumulative_max(jnp.asarray(values)), maxima)


def test_scans_of_a_batch_equal_numpy():
    values = np.random.default_rng(0).integers(0, 9, (3, 130)).astype(np.int32)
    sums = jax.vmap(cumulative_sum)(jnp.asarray(values))
    np.testing.assert_array_equal(sums, np.cumsum(values, 1))
