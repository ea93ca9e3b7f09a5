"""Steps of the loops through tile lists stay on one core, as `numerics.one_core` describes."""

import os
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d.numerics.batched_loops import repeat
from softras2d.numerics.one_core import on_one_core

from ..oracles.compiled_loops import innermost_loops

on_several_cores = pytest.mark.skipif(
    jax.default_backend() != "cpu" or (os.cpu_count() or 1) < 2,
    reason="about CPUs with several cores",
)
MOST_OPERATIONS = 8


def take(rows: jax.Array, index: jax.Array) -> jax.Array:
    return rows.at[index].get(mode="clip")


def sum_of_rows(gather, rows: jax.Array) -> jax.Array:
    """Sum rows that are gathered in the steps of a loop by `gather(step, rows, index)`."""
    index = jnp.arange(16, dtype=jnp.int32)

    def add(step, total):
        return total + gather(step, rows, index + 16 * step)

    with jax.named_scope("sum_of_rows"):
        return repeat(jnp.asarray(20, jnp.int32), add, jnp.zeros((16, rows.shape[1])))


def by_plain_gather(rows: jax.Array) -> jax.Array:
    return sum_of_rows(lambda step, rows, index: take(rows, index), rows)


def by_one_core(rows: jax.Array) -> jax.Array:
    return sum_of_rows(lambda step, *args: on_one_core(take, step, *args), rows)


def cut_in(function, rows) -> list[str]:
    """Operations in the loop of `sum_of_rows` that are cut into parts for several threads."""
    loops = innermost_loops(jax.jit(function).lower(rows).compile(), "sum_of_rows")
    assert loops
    return [line for loop in loops for line in loop.cut]


@on_several_cores
def test_a_gather_from_a_large_array_is_cut_into_parts_elsewhere():
    """If this fails, the compiler counts only what is gathered, and `on_one_core` can go."""
    assert cut_in(by_plain_gather, jnp.zeros((50_000, 8), jnp.float32))


@on_several_cores
def test_a_gather_on_one_core_is_not_cut_into_parts():
    assert not cut_in(by_one_core, jnp.zeros((50_000, 8), jnp.float32))


def test_values_are_those_of_the_function():
    rows = jnp.asarray(np.random.default_rng(0).normal(size=(400, 8)))
    np.testing.assert_allclose(by_one_core(rows), by_plain_gather(rows), rtol=1e-6)


def test_derivatives_are_those_of_the_function():
    rows = jnp.asarray(np.random.default_rng(0).normal(size=(400, 8)))
    change = jnp.asarray(np.random.default_rng(1).normal(size=(400, 8)))
    np.testing.assert_allclose(
        jax.jvp(by_one_core, (rows,), (change,))[1],
        jax.jvp(by_plain_gather, (rows,), (change,))[1],
        rtol=1e-5,
        atol=1e-6,
    )


@pytest.mark.parametrize("axes", [(0, None), (None, 0), (0, 0)])
def test_a_batch_equals_a_loop(axes):
    rng = np.random.default_rng(0)
    rows = jnp.asarray(rng.normal(size=(3, 40, 8)) if axes[0] == 0 else rng.normal(size=(40, 8)))
    index = jnp.asarray(rng.integers(0, 40, (3, 5) if axes[1] == 0 else 5), jnp.int32)
    step = jnp.asarray(1, jnp.int32)

    def one(rows, index):
        return on_one_core(take, step, rows, index)

    batch = jax.vmap(one, axes)(rows, index)
    for k in range(3):
        of_element = [x[k] if axis == 0 else x for x, axis in zip((rows, index), axes, strict=True)]
        np.testing.assert_array_equal(batch[k], one(*of_element))


@on_several_cores
@pytest.mark.slow
@pytest.mark.parametrize("corners", [1, 3])
@pytest.mark.parametrize("has_depth", [False, True])
def test_loops_through_tile_lists_stay_on_one_core(corners, has_depth):
    """So do those of the gradient with respect to colours."""
    count, side = 1000, 512
    rng = np.random.default_rng(0)
    centres = rng.uniform(0, side, (count, 1, 2))
    scene = sr.Scene.from_soup(
        centres + rng.uniform(-40, 40, (count, 3, 2)),
        rng.uniform(size=(count, corners, 4)),
        depth=rng.uniform(size=(count, 3)) if has_depth else None,
    )
    plan = sr.plan(scene, height=side, width=side, coverage=sr.Hard(16, edge_gradients=False))

    def loss(colors):
        return jnp.sum(sr.render(replace(scene, colors=colors), plan) ** 2)

    program = jax.jit(jax.grad(loss)).lower(scene.colors).compile()
    for scope in ["transmittance", "depth_test", "transpose"]:
        loops = innermost_loops(program, scope)
        assert loops or scope == "depth_test"
        for loop in loops:
            assert not loop.cut
            assert loop.most_operations <= MOST_OPERATIONS
