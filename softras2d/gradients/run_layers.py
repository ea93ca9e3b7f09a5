"""Visits the layers at the samples of a run together, as they share the lists of their tiles.

What is read for a layer is read once for all samples of a run. Only what differs from sample to
sample is computed for each.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, UInt32

from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from .layer_masks import LayerMasks, find_in_lists, first_layer, most_layers
from .run_tiles import RunTiles


class ListedEdges(NamedTuple):
    """Where the triangle of each run's edge is in the lists of the run's tiles.

    - `position`: number of entries before it, by draw order.
    - `is_listed`: whether the next entry is the triangle.
    """

    position: Int[Array, "2 runs"]
    is_listed: Bool[Array, "2 runs"]


def list_edges(masks: LayerMasks, tiles: RunTiles, triangle: Int[Array, " runs"]) -> ListedEdges:
    """Find a triangle for each run in the lists of both tiles."""
    both = jnp.stack([triangle, triangle])
    return ListedEdges(
        *find_in_lists(masks.lists, tiles.tile, both, max_list_length=masks.max_list_length)
    )


def visit_run_layers(
    mask: UInt32[Array, "lines runs"],
    tiles: RunTiles,
    listed_triangles: Int[Array, " pairs"],
    plane: Int[Array, ""],
    visit: Callable[[Any, Int[Array, "2 runs"], UInt32[Array, "2 runs"]], Any],
    state: Any,
) -> Any:
    """Visit the layers of a plane at the samples of every run, from the front.

    `visit(state, triangle, bit)` returns the next state. `triangle` is the next layer of any sample
    in either tile; it is a layer of the samples whose `mask` has the tile's `bit`. The bit is 0 for
    tiles without further layers, where `triangle` means nothing.
    """

    def visit_next(_: Int[Array, ""], carry: tuple[Array, Any]) -> tuple[Array, Any]:
        remaining, state = carry
        triangle = first_layer(remaining, tiles.start, listed_triangles, plane)
        bit = remaining & (~remaining + jnp.uint32(1))
        return remaining ^ bit, visit(state, triangle, bit)

    of_any_sample = _unite(mask, tiles.is_second)
    return repeat(most_layers(of_any_sample), visit_next, (of_any_sample, state))[1]


@materialized
def _unite(
    mask: UInt32[Array, "lines runs"], is_second: Bool[Array, "lines runs"]
) -> UInt32[Array, "2 runs"]:
    """The entries that any sample of a run has in its mask, in each of both tiles."""
    no_bits = jnp.zeros_like(mask[0])
    first, second = no_bits, no_bits
    for line_mask, line_is_second in zip(mask, is_second, strict=True):
        first = first | jnp.where(line_is_second, no_bits, line_mask)
        second = second | jnp.where(line_is_second, line_mask, no_bits)
    return jnp.stack([first, second])
