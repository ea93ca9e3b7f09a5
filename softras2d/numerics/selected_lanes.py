"""Work on the few lanes of an array that need it, gathered into groups."""

from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from .batched_loops import repeat
from .fusion_barrier import materialized
from .prefix import cumulative_sum

State = TypeVar("State")
"""A tree of arrays."""

_GROUP = 512
"""Number of lanes that are worked on together."""


def visit_selected(
    selected: Bool[Array, " lanes"],
    visit: Callable[[Int[Array, " group"], State], State],
    state: State,
) -> State:
    """Compute `state = visit(lanes, state)` for groups of the selected lanes.

    `lanes` are their indices. The last group is filled up with the number of lanes, an index past
    the last: gather with the mode "clip", and write with "drop".
    """
    indices, count = _list_selected(selected)
    indices = jnp.pad(indices, (0, -selected.size % _GROUP), constant_values=selected.size)

    def visit_group(group: Int[Array, ""], state: State) -> State:
        return visit(jax.lax.dynamic_slice_in_dim(indices, group * _GROUP, _GROUP), state)

    return repeat(-(-count // _GROUP), visit_group, state)


@materialized
def _list_selected(
    selected: Bool[Array, " lanes"],
) -> tuple[Int[Array, " lanes"], Int[Array, ""]]:
    """List the indices of the selected lanes, and count them; unused entries are past the last."""
    lanes = selected.size
    end = cumulative_sum(selected.astype(jnp.int32))
    entry = jnp.where(selected, end - 1, lanes)
    numbers = jnp.arange(lanes, dtype=jnp.int32)
    return jnp.full(lanes, lanes, jnp.int32).at[entry].set(numbers, mode="drop"), end[-1]
