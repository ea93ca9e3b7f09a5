"""Selected lanes are visited in groups, each lane exactly once."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from softras2d.numerics.selected_lanes import visit_selected


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 1.0])
def test_each_selected_lane_is_visited_once(share):
    selected = jnp.asarray(np.random.default_rng(0).random(2000) < share)

    @jax.jit
    def count(selected):
        def visit(lanes, visits):
            return visits.at[lanes].add(1, mode="drop")

        return visit_selected(selected, visit, jnp.zeros(selected.shape, jnp.int32))

    np.testing.assert_array_equal(count(selected), selected.astype(jnp.int32))
    batch = jnp.stack([selected, ~selected])
    np.testing.assert_array_equal(jax.vmap(count)(batch), batch.astype(jnp.int32))
