"""Visit the layers of all samples of a run together, because they share the lists of their tiles.

A run is a group of successive crossings of one edge (`runs.Runs`); its samples here are the
samples outside the edge. The data of a layer are read once for all samples of a run. Only values
that differ from sample to sample are computed for each sample. Layers are visited plane by plane: a
plane has the layer masks for 32 successive entries of every tile's list (`layer_masks`).
"""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, UInt32

from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from .layer_masks import PLANE, LayerMasks, find_in_lists, most_layers
from .run_tiles import RunTiles

State = TypeVar("State")
"""A tree of arrays."""


class ListedEdges(NamedTuple):
    """Where the triangle of each run's edge is in the lists of both tiles of the run (`RunTiles`).

    - `position`: number of entries in the list that are drawn after the triangle.
    - `is_listed`: whether the entry that follows them is the triangle itself.
    """

    position: Int[Array, "2 runs"]
    is_listed: Bool[Array, "2 runs"]


class RunLayer(NamedTuple):
    """One layer of each run: an entry of the list of each of its two tiles.

    - `step`: number of the step in which the layer is visited, from 0.
    - `pair`: index of the entries in the tile lists. It is any index where `bit` is 0.
    - `bit`: bit of each entry in the layer masks of its tile; 0 where a tile has no further layer.
    """

    step: Int[Array, ""]
    pair: Int[Array, "2 runs"]
    bit: UInt32[Array, "2 runs"]


def list_edges(masks: LayerMasks, tiles: RunTiles, triangle: Int[Array, " runs"]) -> ListedEdges:
    """Find where the triangle of each run's edge is in the lists of both tiles, if it is listed."""
    both = jnp.stack([triangle, triangle])
    return ListedEdges(
        *find_in_lists(masks.lists, tiles.tile, both, max_list_length=masks.max_list_length)
    )


def visit_run_layers(
    mask: UInt32[Array, "lines runs"],
    tiles: RunTiles,
    plane: Int[Array, ""],
    visit: Callable[[State, RunLayer], State],
    state: State,
    *,
    pairs: int,
) -> State:
    """Visit the layers of a plane at the samples of every run, from the front.

    Returns the last state. In each step, `visit(state, layer)` returns the next state. The entries
    of `layer` are, for each of the two tiles of a run, the next list entry that covers any of the
    run's samples there. It is a layer of those samples of the tile whose `mask` contains its bit.

    - `mask`: layer mask of each sample in the plane of number `plane`, whose bit b stands for entry
      32 `plane` + b of the list of the sample's tile (`LayerMasks`).
    - `tiles`: the tiles of each run's samples.
    - `pairs`: number of entries of the tile lists.
    """

    def visit_next(step: Int[Array, ""], carry: tuple[Array, State]) -> tuple[Array, State]:
        remaining, state = carry
        pair, bit, remaining = _next_layer(remaining, tiles.start, plane, jnp.int32(pairs - 1))
        return remaining, visit(state, RunLayer(step, pair, bit))

    of_any_sample = _unite(mask, tiles.is_second)
    return repeat(most_layers(of_any_sample), visit_next, (of_any_sample, state))[1]


@materialized
def _next_layer(
    remaining: UInt32[Array, "2 runs"],
    list_start: Int[Array, "2 runs"],
    plane: Int[Array, ""],
    last: Int[Array, ""],
) -> tuple[Int[Array, "2 runs"], UInt32[Array, "2 runs"], UInt32[Array, "2 runs"]]:
    """Find the entry of the lowest bit of each mask: its index in the tile lists, and the bit.

    Also returns the masks without this bit. `last` is the last index of the tile lists.
    """
    bit = remaining & (~remaining + jnp.uint32(1))
    entry = jax.lax.population_count(bit - jnp.uint32(1)).astype(jnp.int32)
    pair = jnp.clip(list_start + plane * PLANE + entry, 0, last)
    return pair, bit, remaining ^ bit


@materialized
def _unite(
    mask: UInt32[Array, "lines runs"], is_second: Bool[Array, "lines runs"]
) -> UInt32[Array, "2 runs"]:
    """Combine the masks of a run's samples by OR, separately for its first and second tile."""
    no_bits = jnp.zeros_like(mask[0])
    first, second = no_bits, no_bits
    for line_mask, line_is_second in zip(mask, is_second, strict=True):
        first = first | jnp.where(line_is_second, no_bits, line_mask)
        second = second | jnp.where(line_is_second, line_mask, no_bits)
    return jnp.stack([first, second])
