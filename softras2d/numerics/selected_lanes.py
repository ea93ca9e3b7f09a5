"""A loop over the lanes that need work, in groups.

A lane is one item of work, such as an index along the last axis of several arrays.
"""

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
    """Apply `state = visit(lanes, state)` to one group of selected lanes after another.

    - `selected`: whether each lane needs work.
    - `visit`: gets the indices of `_GROUP` selected lanes. In the last group, unused entries are
      the index one past the last lane: `visit` should gather with the mode "clip", and write with
      "drop".

    Lanes are visited in ascending order. Returns the state after the last group, which is `state`
    if no lane is selected. Not differentiable in reverse mode if `selected` is traced. Under
    `jax.vmap`, `visit` may also be called with groups in which all entries are unused.
    """
    capacity = selected.size + -selected.size % _GROUP
    indices, count = materialized(functools.partial(list_flagged, capacity=capacity))(selected)

    def visit_group(group: Int[Array, ""], state: State) -> State:
        return visit(jax.lax.dynamic_slice_in_dim(indices, group * _GROUP, _GROUP), state)

    return repeat(-(-count // _GROUP), visit_group, state)
