"""The loops over the layers beside an edge: what is in front of its triangle, and what is behind.

Without depth the draw order alone decides. Then the layers in front only dim, so that their alpha
is enough, and the layers behind have nothing to do with those in front: each kind has its own loop.
With depth each layer is compared with the edge's triangle at each sample, in one loop.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..coverage.depth_test import Depths, depth_at
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..numerics.rows import Columns
from .crossings import Sample
from .layered_samples import later_is_in_front
from .listed_colors import ListedColors
from .run_layers import RunLayer, visit_run_layers
from .run_tiles import RunTiles
from .surroundings import (
    Behind,
    PixelCotangent,
    Surroundings,
    add_behind,
    still_matter_behind,
    values_of,
)


class VisitedLayers(NamedTuple):
    """Masks of the layers to visit at each crossing, for 32 entries of a tile list (`LayerMasks`).

    A layer is in front of the edge's triangle here if it is drawn later, and behind it if it is
    drawn earlier.

    - `front_outside`, `front_inside`: layers in front that dim the edge's triangle at the samples
      outside and inside. With depth, or with more than one colour per triangle, `front_inside` has
      only layers that cover both samples.
    - `behind`: layers of the sample outside that are behind.
    """

    front_outside: UInt32[Array, "lines runs"]
    front_inside: UInt32[Array, "lines runs"]
    behind: UInt32[Array, "lines runs"]


class RunSamples(NamedTuple):
    """The samples outside the edges of a group of runs, and data of the edges' triangles there.

    - `outside`: these samples, and `tiles` the tiles in which they lie.
    - `triangle`: the triangle of each run's edge.
    - `depth`: depth of this triangle at the samples; None without depth.
    - `cotangent`: cotangent of the pixel of each crossing, or None (`PixelCotangent`).
    """

    outside: Sample
    tiles: RunTiles
    triangle: Int[Array, " runs"]
    depth: Float[Array, "lines runs"] | None
    cotangent: PixelCotangent


def visit_in_draw_order(
    colors: ListedColors,
    runs: RunSamples,
    layers: VisitedLayers,
    plane: Int[Array, ""],
    state: Surroundings,
    tiling: Tiling,
) -> Surroundings:
    """Add the layers of one plane to the surroundings, in a scene without depth.

    `plane` is the number of the plane from which the masks in `layers` are.
    """

    def visit_front(in_front: tuple[Array, Array], layer: RunLayer) -> tuple[Array, Array]:
        gathered = colors.gather(layer.pair, layer.step, alpha_only=True)
        return _dim(in_front, colors, gathered, layer.bit, layers, runs, tiling=tiling)

    def visit_behind(behind: Behind, layer: RunLayer) -> Behind:
        gathered = colors.gather(layer.pair, layer.step, alpha_only=False)
        return _add_behind(behind, colors, gathered, layer.bit, layers, runs, tiling=tiling)

    visit_all = functools.partial(
        visit_run_layers, tiles=runs.tiles, plane=plane, pairs=colors.triangle.shape[0]
    )
    in_front = state.in_front_outside, state.in_front_inside
    in_front_mask = layers.front_outside | layers.front_inside
    outside, inside = visit_all(in_front_mask, visit=visit_front, state=in_front)
    state = state._replace(in_front_outside=outside, in_front_inside=inside)
    # Read from within `visit_behind` too.
    layers = layers._replace(behind=_without_unseen(layers.behind, state))
    behind = visit_all(layers.behind, visit=visit_behind, state=state.behind)
    return state._replace(behind=behind)


@materialized
def _without_unseen(
    behind: UInt32[Array, "lines runs"], state: Surroundings
) -> UInt32[Array, "lines runs"]:
    """Remove the layers behind whose effect is too small to notice (`still_matter_behind`)."""
    return jnp.where(still_matter_behind(state), behind, jnp.uint32(0))


@functools.partial(materialized, static_argnames=("tiling",))
def _dim(
    in_front: tuple[Float[Array, "lines runs"], Float[Array, "lines runs"]],
    colors: ListedColors,
    gathered: Columns | Int[Array, "2 runs"],
    bit: UInt32[Array, "2 runs"],
    layers: VisitedLayers,
    runs: RunSamples,
    *,
    tiling: Tiling,
) -> tuple[Float[Array, "lines runs"], Float[Array, "lines runs"]]:
    """Multiply the transmittances at the samples outside and inside by that of the next layer.

    `gathered` and `bit` are of the next entry of each tile (`RunLayer`).
    """
    alpha = colors.alpha(gathered, runs.tiles, runs.outside, tiling)
    bits = runs.tiles.of_samples(bit)
    outside, inside = (
        transmittance * jnp.where((mask & bits) != 0, 1.0 - alpha, 1.0)
        for transmittance, mask in zip(in_front, layers[:2], strict=True)
    )
    return outside, inside


@functools.partial(materialized, static_argnames=("tiling",))
def _add_behind(
    behind: Behind,
    colors: ListedColors,
    gathered: Columns | Int[Array, "2 runs"],
    bit: UInt32[Array, "2 runs"],
    layers: VisitedLayers,
    runs: RunSamples,
    *,
    tiling: Tiling,
) -> Behind:
    """Composite the next layer behind the others; `gathered` and `bit` are as in `_dim`."""
    color = colors.color(gathered, runs.tiles, runs.outside, tiling)
    is_behind = (layers.behind & runs.tiles.of_samples(bit)) != 0
    return add_behind(behind, values_of(color, runs.cotangent), color[-1], is_behind)


def visit_by_depth(
    colors: ListedColors,
    depths: Depths,
    runs: RunSamples,
    layers: VisitedLayers,
    plane: Int[Array, ""],
    state: Surroundings,
    tiling: Tiling,
) -> Surroundings:
    """Add the layers of one plane to the surroundings, in a scene with depth.

    `plane` is the number of the plane from which the masks in `layers` are.
    """

    def visit(state: Surroundings, layer: RunLayer) -> Surroundings:
        gathered = colors.gather(layer.pair, layer.step, alpha_only=False)
        triangle = runs.tiles.of_samples(colors.triangle[layer.pair])
        is_later_in_front = later_is_in_front(
            triangle,
            runs.triangle[None],
            depth_at(depths, triangle, runs.outside, tiling),
            runs.depth,
        )
        return _add_by_depth(
            state, colors, gathered, layer.bit, layers, is_later_in_front, runs, tiling=tiling
        )

    mask = layers.front_outside | layers.behind
    pairs = colors.triangle.shape[0]
    return visit_run_layers(mask, runs.tiles, plane, visit, state, pairs=pairs)


@functools.partial(materialized, static_argnames=("tiling",))
def _add_by_depth(
    state: Surroundings,
    colors: ListedColors,
    gathered: Columns | Int[Array, "2 runs"],
    bit: UInt32[Array, "2 runs"],
    layers: VisitedLayers,
    is_later_in_front: Bool[Array, "lines runs"],
    runs: RunSamples,
    *,
    tiling: Tiling,
) -> Surroundings:
    """Add the next layer to the surroundings, in a scene with depth.

    `gathered` and `bit` are as in `_dim`. `is_later_in_front` says whether, of the layer and the
    edge's triangle, the one that is drawn later lies in front.
    """
    assert state.hidden is not None and state.if_absent is not None
    color = colors.color(gathered, runs.tiles, runs.outside, tiling)
    values, alpha = values_of(color, runs.cotangent), color[-1]
    bits = runs.tiles.of_samples(bit)
    is_later, is_later_at_both, is_earlier = ((mask & bits) != 0 for mask in layers)
    outside, inside = (
        transmittance * jnp.where(is_layer & is_later_in_front, 1.0 - alpha, 1.0)
        for transmittance, is_layer in (
            (state.in_front_outside, is_later),
            (state.in_front_inside, is_later_at_both),
        )
    )
    is_visible_alone = (is_later & ~is_later_in_front) | is_earlier
    return Surroundings(
        outside,
        inside,
        add_behind(state.behind, values, alpha, is_earlier),
        state.hidden | (is_earlier & ~is_later_in_front),
        add_behind(state.if_absent, values, alpha, is_visible_alone),
    )
