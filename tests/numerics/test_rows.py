"""Rows of packed arrays hold the entries of the arrays, at their own dtypes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softras2d.numerics.rows import pack_rows

STEP = jnp.asarray(0, jnp.int32)


def tree_of(seed: int, count: int, real: type) -> dict:
    """Arrays of several shapes and dtypes, with `count` entries along the last axis."""
    rng = np.random.default_rng(seed)
    return {
        "numbers": jnp.asarray(rng.integers(-(2**31), 2**31, (3, count)), jnp.int32),
        "real": jnp.asarray(rng.normal(size=(2, 2, count)), real),
        "flag": jnp.asarray(rng.integers(0, 2, count), bool),
        "nothing": None,
        "single": jnp.asarray(rng.normal(size=count), jnp.float32),
    }


@given(
    seed=st.integers(0, 100),
    index=st.lists(st.integers(0, 11), min_size=1, max_size=6),
    repeats=st.integers(1, 3),
    real=st.sampled_from([np.float32, np.float64]),
)
def test_gathered_entries_are_those_of_the_arrays(seed, index, repeats, real):
    with jax.enable_x64(real is np.float64):
        tree = tree_of(seed, 10, real)
        wanted = np.repeat(np.clip(index, 0, 9), repeats)
        rows = pack_rows(tree)
        columns = rows.gather(jnp.asarray(index, jnp.int32), STEP, repeats=repeats).unpack()
        assert jax.tree.structure(columns) == jax.tree.structure(tree)
        for column, array in zip(jax.tree.leaves(columns), jax.tree.leaves(tree), strict=True):
            assert column.dtype == array.dtype
            np.testing.assert_array_equal(column, array[..., wanted])


@pytest.mark.parametrize("kind", ["numbers", "single"])
def test_a_tree_may_have_one_kind_of_numbers(kind):
    array = tree_of(0, 10, np.float32)[kind]
    gathered = pack_rows(array).gather(jnp.asarray([3, 1], jnp.int32), STEP, repeats=1)
    assert (gathered.integers is None) == (kind == "single")
    assert (gathered.floats is None) == (kind == "numbers")
    np.testing.assert_array_equal(gathered.unpack(), array[..., jnp.asarray([3, 1])])


def test_derivatives_pass_through():
    tree, change = tree_of(0, 10, np.float32), tree_of(1, 10, np.float32)
    index = jnp.asarray([7, 2, 7], jnp.int32)

    def gather(real):
        return pack_rows(tree | {"real": real}).gather(index, STEP, repeats=2).unpack()["real"]

    tangent = jax.jvp(gather, (tree["real"],), (change["real"],))[1]
    np.testing.assert_array_equal(tangent, jnp.repeat(change["real"][..., index], 2, -1))
