"""Visit the layers of all samples of a part of a run together, because they share a tile's list.

A run is a group of successive crossings of one edge (`runs.Runs`), and the samples of a part of it
lie in one tile (`run_parts`). The data of a layer are read once for all samples of a part. Only
values that differ from sample to sample are computed for each sample. Layers are visited plane by
plane: a plane has the layer masks for 32 successive entries of every tile's list (`layer_masks`).
"""

import functools
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, UInt32

from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from .layer_masks import PLANE, most_layers

State = TypeVar("State")
"""A tree of arrays."""


class PartLayer(NamedTuple):
    """One layer of each part of a run: an entry of the list of its tile.

    - `step`: number of the step in which the layer is visited, from 0.
    - `pair`: index of the entry in the tile lists. It is any index where `bit` is 0.
    - `bit`: bit of the entry in the layer masks of its tile; 0 where a part has no further layer.
    """

    step: Int[Array, ""]
    pair: Int[Array, " parts"]
    bit: UInt32[Array, " parts"]


def visit_part_layers(
    mask: UInt32[Array, "lines parts"],
    list_start: Int[Array, " parts"],
    plane: Int[Array, ""],
    visit: Callable[[State, PartLayer], State],
    state: State,
    *,
    pairs: int,
) -> State:
    """Visit the layers of a plane at the samples of every part of a run, from the front.

    Returns the last state. In each step, `visit(state, layer)` returns the next state. `layer` has,
    for each part, the next entry of the list of its tile that covers any of its samples. It is a
    layer of those samples whose `mask` contains its bit.

    - `mask`: layer mask of each sample in the plane of number `plane`, whose bit b stands for entry
      32 `plane` + b of the list of the part's tile (`LayerMasks`).
    - `list_start`: index in the tile lists of the first entry of this list.
    - `pairs`: number of entries of the tile lists.
    """

    def visit_next(step: Int[Array, ""], carry: tuple[Array, State]) -> tuple[Array, State]:
        remaining, state = carry
        pair, bit, remaining = _next_layer(remaining, list_start, plane, jnp.int32(pairs - 1))
        return remaining, visit(state, PartLayer(step, pair, bit))

    of_any_sample = _unite(mask)
    return repeat(most_layers(of_any_sample), visit_next, (of_any_sample, state))[1]


@materialized
def _next_layer(
    remaining: UInt32[Array, " parts"],
    list_start: Int[Array, " parts"],
    plane: Int[Array, ""],
    last: Int[Array, ""],
) -> tuple[Int[Array, " parts"], UInt32[Array, " parts"], UInt32[Array, " parts"]]:
    """Find the entry of the lowest bit of each mask: its index in the tile lists, and the bit.

    Also returns the masks without this bit. `last` is the last index of the tile lists.
    """
    bit = remaining & (~remaining + jnp.uint32(1))
    entry = jax.lax.population_count(bit - jnp.uint32(1)).astype(jnp.int32)
    pair = jnp.clip(list_start + plane * PLANE + entry, 0, last)
    return pair, bit, remaining ^ bit


@materialized
def _unite(mask: UInt32[Array, "lines parts"]) -> UInt32[Array, " parts"]:
    """Combine the masks of the samples of each part by OR."""
    return functools.reduce(jnp.bitwise_or, list(mask))
