"""`materialized` stops XLA on a CPU from fusing two steps; JAX's own barrier does not."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softras2d.numerics.fusion_barrier import materialized

on_cpu = pytest.mark.skipif(jax.default_backend() != "cpu", reason="the barrier is for the CPU")


def produce(x: jax.Array) -> jax.Array:
    """An elementwise step that is costly to repeat."""
    return jnp.sin(x) * 3.0


def consume(y: jax.Array) -> jax.Array:
    """A step that reads every element three times."""
    return y + jnp.roll(y, 1) * jnp.roll(y, 2)


def chain(barrier: Callable) -> Callable[[jax.Array], jax.Array]:
    """A function of both steps, with `barrier` around the first."""
    return lambda x: consume(barrier(produce)(x))


def optimization_barrier(function: Callable) -> Callable:
    """Wrap the result of a function in JAX's own barrier."""
    return lambda x: jax.lax.optimization_barrier(function(x))


def is_fused(function: Callable) -> bool:
    """Whether one computation of the compiled program contains both steps."""
    text = jax.jit(function).lower(jnp.zeros(4096, jnp.float32)).compile().as_text()
    assert text is not None
    return any("sine(" in part and "slice(" in part for part in text.split("\n\n"))


@on_cpu
def test_a_materialized_function_is_not_fused():
    assert not is_fused(chain(materialized))


@on_cpu
@pytest.mark.parametrize("barrier", [lambda f: f, optimization_barrier], ids=["none", "jax"])
def test_other_chains_are_fused(barrier):
    """If this fails, the compiler no longer fuses the steps, and `materialized` can go."""
    assert is_fused(chain(barrier))


def test_values_and_derivatives_are_those_of_the_function():
    x = jnp.linspace(0.0, 2.0, 7)
    plain, apart = chain(lambda f: f), chain(materialized)
    np.testing.assert_allclose(apart(x), plain(x), rtol=1e-6)
    np.testing.assert_allclose(jax.jacobian(apart)(x), jax.jacobian(plain)(x), rtol=1e-5, atol=1e-6)
