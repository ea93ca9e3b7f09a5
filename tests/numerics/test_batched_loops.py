"""In a batch, loops and branches take the same steps for all elements, with the right results.

Elements that need fewer steps must not be changed by the further ones.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softras2d.numerics.batched_loops import apply_if_any, greatest_of_batch, repeat

COUNTS = jnp.asarray([[3, 0], [5, 1]], jnp.int32)


def sum_below(count):
    """0 + 1 + ... + (count - 1), even if the loop takes more than `count` steps."""

    def step(number, total):
        return total + jnp.where(number < count, number, 0)

    return repeat(count, step, jnp.zeros((), jnp.int32))


def square_if_positive(x):
    """x^2 for positive x, else x."""
    return apply_if_any(x > 0, lambda x: jnp.where(x > 0, x**2, x), x)


def test_greatest_of_batch_is_the_same_for_all_elements():
    assert int(greatest_of_batch(COUNTS[0, 0])) == 3
    np.testing.assert_array_equal(jax.vmap(greatest_of_batch)(COUNTS[:, 1]), [1, 1])
    of_nested = jax.jit(jax.vmap(jax.vmap(greatest_of_batch)))(COUNTS)
    np.testing.assert_array_equal(of_nested, np.full((2, 2), 5))


def test_greatest_of_what_is_not_batched_is_itself():
    both = jax.vmap(lambda x, count: (x, greatest_of_batch(count)), in_axes=(0, None))
    np.testing.assert_array_equal(both(COUNTS[:, 0], COUNTS[0, 1])[1], [0, 0])


def test_repeat_counts_its_steps():
    for count in (0, 1, 5):
        assert int(repeat(jnp.int32(count), lambda number, n: n + 1, jnp.int32(0))) == count
        assert int(jax.jit(sum_below)(jnp.int32(count))) == sum(range(count))


def test_all_elements_of_a_batch_take_the_most_steps():
    steps = jax.vmap(lambda count: repeat(count, lambda number, n: n + 1, jnp.int32(0)))
    np.testing.assert_array_equal(steps(COUNTS[1]), [5, 5])


def test_repeat_of_a_batch_equals_a_loop():
    expected = [[sum(range(count)) for count in row] for row in COUNTS.tolist()]
    np.testing.assert_array_equal(jax.vmap(sum_below)(COUNTS[0]), expected[0])
    np.testing.assert_array_equal(jax.jit(jax.vmap(jax.vmap(sum_below)))(COUNTS), expected)


def test_repeat_has_forward_derivatives():
    def power(x, count):
        """x to the power of count."""
        return repeat(count, lambda number, p: jnp.where(number < count, p * x, p), jnp.ones(()))

    x = jnp.asarray([1.5, 2.0])
    tangent = jax.jvp(lambda x: jax.vmap(power)(x, COUNTS[1]), (x,), (jnp.ones(2),))[1]
    np.testing.assert_allclose(tangent, [5 * 1.5**4, 1], rtol=1e-6)


def test_gradients_pass_by_a_loop_over_integers():
    def scaled(x):
        """x times the sum of the numbers below its integer part."""
        return x * sum_below(jax.lax.stop_gradient(x).astype(jnp.int32)).astype(x.dtype)

    x = jnp.asarray([[3.5, 0.5], [5.5, 1.5]])
    expected = [[3, 0], [10, 0]]
    batch = jax.vmap(jax.vmap(scaled))
    np.testing.assert_array_equal(jax.grad(lambda x: jnp.sum(batch(x)))(x), expected)
    np.testing.assert_array_equal(jax.jit(jax.vmap(jax.vmap(jax.grad(scaled))))(x), expected)


def test_apply_if_any_changes_only_what_needs_it():
    x = jnp.asarray([[3.0, -2.0], [-1.0, -4.0]])
    expected = [[9, -2], [-1, -4]]
    assert float(square_if_positive(x[0, 0])) == 9
    assert float(square_if_positive(x[0, 1])) == -2
    for row in range(2):
        np.testing.assert_array_equal(jax.vmap(square_if_positive)(x[row]), expected[row])
    nested = jax.jit(jax.vmap(jax.vmap(square_if_positive)))(x)
    np.testing.assert_array_equal(nested, expected)


def test_a_branch_runs_for_all_elements_or_for_none():
    """The branch adds 1 wherever it runs, and so shows for which elements it ran."""
    run = jax.vmap(lambda condition: apply_if_any(condition, lambda n: n + 1, jnp.int32(0)))
    np.testing.assert_array_equal(run(jnp.asarray([False, True])), [1, 1])
    np.testing.assert_array_equal(run(jnp.asarray([False, False])), [0, 0])


@pytest.mark.parametrize("x", [[3.0, -2.0], [-1.0, -4.0]])
def test_apply_if_any_has_derivatives_in_both_directions(x):
    x = jnp.asarray(x)
    expected = np.where(np.asarray(x) > 0, 2 * np.asarray(x), 1)
    batch = jax.vmap(square_if_positive)
    np.testing.assert_array_equal(jax.grad(lambda x: jnp.sum(batch(x)))(x), expected)
    np.testing.assert_array_equal(jax.vmap(jax.grad(square_if_positive))(x), expected)
    np.testing.assert_array_equal(jax.jvp(batch, (x,), (jnp.ones(2),))[1], expected)
    checkpointed = jax.vmap(jax.grad(jax.checkpoint(square_if_positive)))
    np.testing.assert_array_equal(jax.jit(checkpointed)(x), expected)
