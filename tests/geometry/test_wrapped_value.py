"""`WrappedValue`, an int32 that wraps around plus a float estimate, acts like a 64-bit integer."""

import jax.numpy as jnp
import numpy as np
import pytest

from softras2d.geometry.wrapped_value import LARGE_ESTIMATE, WrappedValue


def values() -> np.ndarray:
    """Integers of up to 43 bits, many of them near zero and near +-2^30."""
    rng = np.random.default_rng(0)
    spread = rng.integers(-(2**43), 2**43, 2000) >> rng.integers(0, 43, 2000)
    near = [base + np.arange(-300, 300) for base in (-LARGE_ESTIMATE, 0, LARGE_ESTIMATE)]
    return np.concatenate([spread, *near])


def wrap(value: np.ndarray, error: float = 2.0**28) -> WrappedValue:
    """Wrap integers, with a float estimate that is wrong by up to `error`."""
    wrong = np.random.default_rng(1).uniform(-error, error, value.shape)
    return WrappedValue(value.astype(np.int32), (value + wrong).astype(np.float32))


@pytest.mark.parametrize("xp", [np, jnp], ids=["numpy", "jax"])
def test_signs_and_floats_are_those_of_the_integers(xp):
    value = values()
    both = WrappedValue(*map(xp.asarray, wrap(value)))
    np.testing.assert_array_equal(both.is_inside(), value >= 0)
    np.testing.assert_array_equal(both.sign(), np.sign(value))
    number = both.to_float(xp.float32)
    np.testing.assert_allclose(number, value, rtol=2.0**-22)
    short = np.abs(value) < 2**31
    np.testing.assert_array_equal(np.asarray(number)[short], value[short].astype(np.float32))


def test_a_remainder_is_added_before_the_sign_is_taken():
    value = np.arange(-300, 300)
    remainder = np.full(value.shape, 255.5, np.float32)
    np.testing.assert_array_equal(wrap(value).is_inside(remainder), value + 255.5 >= 0)


def test_clamped_is_exact_near_zero():
    value = values()
    clamped = wrap(value).clamped()
    near = np.abs(value) < LARGE_ESTIMATE // 2
    np.testing.assert_array_equal(clamped[near], value[near])
    np.testing.assert_array_equal(np.sign(clamped), np.sign(value))
    assert (np.abs(clamped[~near]) >= LARGE_ESTIMATE // 2).all()


def test_moves_and_multiples_wrap_like_the_integers():
    rng = np.random.default_rng(2)
    start = rng.integers(-(2**40), 2**40, 500)
    step, count = (rng.integers(-(2**n), 2**n, 500).astype(np.int32) for n in (23, 18))
    times = rng.integers(0, 257, 500).astype(np.int32)
    moved = wrap(start, 0.0).times(times).moved((step, count), (count, step))
    exact = start * times + 2 * step.astype(np.int64) * count
    np.testing.assert_array_equal(moved.sign(), np.sign(exact))
    np.testing.assert_array_equal(moved.wrapped, exact.astype(np.int32))


@pytest.mark.parametrize("xp", [np, jnp], ids=["numpy", "jax"])
def test_split_values_add_up_and_leave_room_for_steps(xp):
    value = values()
    # The estimate of one edge value errs by less than 2^20, and by the rounding of a float.
    remainder, multiple = WrappedValue(*map(xp.asarray, wrap(value, 2.0**20))).split()
    exact = np.asarray(remainder, np.int64) + np.asarray(multiple, np.float64).astype(np.int64)
    np.testing.assert_array_equal(exact, value)
    assert np.abs(np.asarray(remainder, np.int64)).max() <= 2**30 + 2**21
