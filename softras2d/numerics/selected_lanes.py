"""A loop over those lanes of an array that need work, gathered into groups."""

import functools
from collections.abc import Callable
from typing import TypeVar

import jax
from jaxtyping import Array, Bool, Int

from .batched_loops import repeat
from .fusion_barrier import materialized
from .prefix import list_flagged

State = TypeVar("State")
"""A tree of arrays."""

_GROUP = 512
"""Number of lanes in a group."""


def visit_selected(
    selected: Bool[Array, " lanes"],
    visit: Callable[[Int[Array, " group"], State], State],
    state: State,
) -> State:
    """Compute `state = visit(lanes, state)` for groups of the selected lanes.

    `lanes` are their indices. Unused entries of the last group are the number of lanes, an index
    past the last: gather with the mode "clip", and write with "drop".
    """
    capacity = selected.size + -selected.size % _GROUP
    indices, count = materialized(functools.partial(list_flagged, capacity=capacity))(selected)

    def visit_group(group: Int[Array, ""], state: State) -> State:
        return visit(jax.lax.dynamic_slice_in_dim(indices, group * _GROUP, _GROUP), state)

    return repeat(-(-count // _GROUP), visit_group, state)
