"""Find the pairs of samples between which a layer of a translucent scene passes behind another.

A triangle that covers two neighbouring samples may pass the depth test at one of them alone. At the
other sample it is hidden by the nearest triangle that was drawn before it. This hiding triangle is,
of the triangles that passed there and were drawn before, the one drawn last. If it covers both
samples too, a line of equal depth lies between them, at which the later triangle appears or
disappears. The colour that the later triangle adds is computed at the sample where it passes, from
the transmittance in front of it, its colour and alpha there, and the layers behind it.
"""

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..binning.tiles import TileLists
from ..coverage.sampled import row_order
from ..geometry.fixed_point import Edges
from ..geometry.tiling import Tiling
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from .crossings import Sample
from .layer_masks import (
    LayerMasks,
    SampleAddress,
    bits_before,
    count_planes,
    find_in_lists,
    first_layer,
    gather_masks,
    locate_layers,
    visit_layers,
)
from .layered_samples import LayeredSamples
from .sample_pairs import Candidates, PairSearch, SamplePairs, decode_group, keep_pairs
from .visible_front import address


class LayerPairs(PairSearch):
    """Search for pairs of samples between which triangles interpenetrate, in translucent scenes.

    `PairSearch` is the interface. A slot is an entry of the tile lists. Of the two triangles of a
    pair, the one that is drawn later appears or disappears between the samples. `masks` are the
    layer masks of `samples.passed`.
    """

    samples: LayeredSamples
    masks: LayerMasks
    tiling: Tiling = eqx.field(static=True)

    @property
    def slot_count(self) -> int:
        """Number of entries of the tile lists, used or not."""
        return self.samples.lists.triangle.shape[0]

    def candidates(self, slot: Int[Array, " slots"]) -> UInt32[Array, "2 slots rows"]:
        """Mark the pairs of samples that a slot's triangle covers, passing at just one of the two.

        "Passes" means passing the depth test. The layout is as in `PairSearch.candidates`.
        """
        lists, tiling, max_list_length = self.samples.lists, self.tiling, self.masks.max_list_length
        tile, triangle, is_used = materialized(_read_entries)(lists, slot)
        words = self.samples.covered, self.samples.passed
        marked = []
        for is_down in (False, True):
            next_tile, exists = _next_tile(tile, tiling, is_down=is_down)
            position, is_listed = find_in_lists(
                lists, next_tile, triangle, max_list_length=max_list_length
            )
            mark = functools.partial(_mark_changes, is_down=is_down, tiling=tiling)
            next_slot = lists.start[next_tile] + position
            marked.append(materialized(mark)(*words, slot, is_used, next_slot, is_listed & exists))
        return jnp.stack(marked)

    def pairs(
        self,
        words: UInt32[Array, " words"],
        ends: Int[Array, " words"],
        slot: Int[Array, " slots"],
        group: Int[Array, ""],
    ) -> tuple[SamplePairs, Int[Array, ""]]:
        """Keep the candidates whose hiding triangle covers both samples too.

        At one of the samples the slot's triangle fails the depth test. The hiding triangle is, of
        the triangles that pass there and were drawn before it, the one drawn last. Arguments and
        results are as in `PairSearch.pairs`.
        """
        tiling, lists = self.tiling, self.samples.lists
        decode = materialized(functools.partial(_decode, tiling=tiling))
        changes = decode(words, ends, lists, self.samples.passed, slot, group)
        where = locate_layers(self.masks, changes.hidden, tiling)
        position, _ = find_in_lists(
            lists, where.tile, changes.triangle, max_list_length=self.masks.max_list_length
        )
        hider = _first_behind(self.masks, where, position)
        return materialized(_keep_covering)(self.samples.edges, changes, hider)

    def color_changes(self, pairs: SamplePairs) -> Float[Array, "channels lanes"]:
        """The colour that the later triangle adds, times -1 if it is hidden at the second sample.

        The later triangle is the one of the pair that is drawn later. The colour that it adds is
        computed at the sample where it passes the depth test (`_added_color`).
        """
        later = jnp.maximum(pairs.before, pairs.after)
        appears = pairs.before < pairs.after
        shown = _choose(appears, pairs.second, pairs.first)
        added = _added_color(self.samples, self.masks, later, shown, self.tiling)
        return jnp.where(appears[None], added, -added)


class _Changes(NamedTuple):
    """Candidates, and where the slot's triangle of each candidate passes the depth test.

    - `triangle`: the slot's triangle, which covers both samples and passes the depth test at one of
      them.
    - `hidden`: the sample at which this triangle fails the depth test.
    - `passes_first`: whether it passes at the first sample of the pair, and so fails at the second.
    """

    candidates: Candidates
    triangle: Int[Array, " lanes"]
    hidden: Sample
    passes_first: Bool[Array, " lanes"]


def _read_entries(
    lists: TileLists, slot: Int[Array, " slots"]
) -> tuple[Int[Array, " slots"], Int[Array, " slots"], Bool[Array, " slots"]]:
    """Return the tile and the triangle of entries of the tile lists, and whether each is used.

    `slot` has the indices of the entries. The tile of an unused entry is 0, and its triangle has no
    meaning.
    """
    is_used = slot < jnp.sum(lists.count, dtype=jnp.int32)
    tile = jnp.where(is_used, lists.tile.at[slot].get(mode="clip"), 0)
    return tile, lists.triangle.at[slot].get(mode="clip"), is_used


def _mark_changes(
    covered: UInt32[Array, "pairs rows"],
    passed: UInt32[Array, "pairs rows"],
    slot: Int[Array, " slots"],
    is_used: Bool[Array, " slots"],
    next_slot: Int[Array, " slots"],
    is_listed: Bool[Array, " slots"],
    *,
    is_down: bool,
    tiling: Tiling,
) -> UInt32[Array, "slots rows"]:
    """Compute `LayerPairs.candidates` for one direction: down if `is_down`, else right.

    A bit is set where the slot's triangle covers the sample and the next one in this direction, and
    passes the depth test at only one of them.

    - `covered`, `passed`: coverage words of all list entries, before and after the depth test.
    - `is_used`: whether each slot is in use.
    - `next_slot`: the entry of the slot's triangle in the list of the next tile in this direction.
    - `is_listed`: whether the next tile exists and lists this triangle.
    """

    every_column = jnp.uint32((1 << tiling.sample_columns) - 1)

    def here_and_next(
        words: UInt32[Array, "pairs rows"],
    ) -> tuple[UInt32[Array, "slots rows"], UInt32[Array, "slots rows"]]:
        here, beyond = (
            jnp.where(is_valid[:, None], words.at[entry].get(mode="clip"), jnp.uint32(0))
            for entry, is_valid in ((slot, is_used), (next_slot, is_listed))
        )
        return here & every_column, _next_samples(here & every_column, beyond, tiling, is_down)

    (covers, covers_next), (passes, passes_next) = map(here_and_next, (covered, passed))
    return covers & covers_next & (passes ^ passes_next)


def _next_tile(
    tile: Int[Array, " slots"], tiling: Tiling, *, is_down: bool
) -> tuple[Int[Array, " slots"], Bool[Array, " slots"]]:
    """Return the tile to the right, or below if `is_down`, and whether there is one on the canvas.

    Where there is none, the tile itself is returned.
    """
    if is_down:
        exists = tile // tiling.columns < tiling.rows - 1
        return jnp.where(exists, tile + tiling.columns, tile), exists
    exists = tile % tiling.columns < tiling.columns - 1
    return jnp.where(exists, tile + 1, tile), exists


def _next_samples(
    words: UInt32[Array, "slots rows"],
    beyond: UInt32[Array, "slots rows"],
    tiling: Tiling,
    is_down: bool,
) -> UInt32[Array, "slots rows"]:
    """Replace the bit of each sample by the bit of its neighbour: right, or below if `is_down`.

    `words` are coverage words of tiles. `beyond` are those of the next tile in this direction,
    which has the neighbours of the last column or row.
    """
    if not is_down:
        first_column = (beyond & jnp.uint32(1)) << jnp.uint32(tiling.sample_columns - 1)
        return (words >> jnp.uint32(1)) | first_column
    row = row_order(tiling)
    word_of_row = jnp.argsort(row)
    below = word_of_row[(row + 1) % tiling.sample_rows]
    is_last = (row == tiling.sample_rows - 1)[None]
    return jnp.where(is_last, beyond[:, below], words[:, below])


def _decode(
    words: UInt32[Array, " words"],
    ends: Int[Array, " words"],
    lists: TileLists,
    passed: UInt32[Array, "pairs rows"],
    slot: Int[Array, " slots"],
    group: Int[Array, ""],
    *,
    tiling: Tiling,
) -> _Changes:
    """Decode a group of candidates, and find the sample at which each slot's triangle passes.

    "Passes" means passing the depth test. The arguments are as in `PairSearch.pairs`; `passed` are
    the coverage words of all list entries after the depth test.
    """
    tile, triangle, _ = _read_entries(lists, slot)
    candidates = decode_group(words, ends, tile, group, tiling)
    _, word_index, bit = address(candidates.first, tiling)
    word = passed[jnp.minimum(slot[candidates.slot], passed.shape[0] - 1), word_index]
    passes_first = (word >> bit) & jnp.uint32(1) == 1
    hidden = _choose(passes_first, candidates.second, candidates.first)
    return _Changes(candidates, triangle[candidates.slot], hidden, passes_first)


def _choose(condition: Bool[Array, " lanes"], first: Sample, second: Sample) -> Sample:
    """Return `first` where the condition holds, else `second`, for each lane."""
    return jax.tree.map(functools.partial(jnp.where, condition), first, second)


def _first_behind(
    masks: LayerMasks, where: SampleAddress, position: Int[Array, " lanes"]
) -> Int[Array, " lanes"]:
    """Find the first layer of each sample from a position in its tile's list on; -1 for none.

    Returns the index of the layer's triangle.

    - `where`: address of the sample's layer masks.
    - `position`: number of the first list entry that counts, from 0.
    """

    def visit_plane(plane: Int[Array, ""], layer: Int[Array, " lanes"]) -> Int[Array, " lanes"]:
        mask = gather_masks(masks, where.mask_index, plane) & ~bits_before(position, plane)
        entry = first_layer(mask, where.start, masks.lists.triangle, plane)
        return jnp.where((layer < 0) & (mask != 0), entry, layer)

    return repeat(count_planes(masks), visit_plane, jnp.full_like(position, -1))


def _keep_covering(
    edges: Edges, changes: _Changes, hider: Int[Array, " lanes"]
) -> tuple[SamplePairs, Int[Array, ""]]:
    """Keep the candidates whose `hider` covers both samples, and make pairs of them.

    `hider` is the triangle that hides `changes.triangle` at one of the samples, -1 for none. It
    covers that sample, so only the other sample has to be tested. Returns the pairs and their
    number, as `keep_pairs` does.
    """
    candidates, passes_first = changes.candidates, changes.passes_first
    shown = _choose(passes_first, candidates.first, candidates.second)
    is_pair = candidates.is_used & (hider >= 0)
    triangle = jnp.maximum(hider, 0)
    for edge in edges:
        is_pair = is_pair & edge.gather(triangle).at(*shown).is_inside()
    before = jnp.where(passes_first, changes.triangle, triangle)
    after = jnp.where(passes_first, triangle, changes.triangle)
    pairs = SamplePairs(before, after, candidates.first, candidates.second, candidates.is_down)
    return keep_pairs(pairs, is_pair)


class _Layers(NamedTuple):
    """The layers of each sample that were visited so far, from the front, split at one triangle.

    - `in_front`: transmittance of the layers in front of the triangle.
    - `color`, `alpha`: premultiplied colour and alpha of the triangle; 0 until it is visited.
    - `behind`: premultiplied colour of the layers behind the triangle.
    - `behind_transmittance`: transmittance of the layers behind the triangle.
    """

    in_front: Float[Array, " lanes"]
    color: Float[Array, "channels lanes"]
    alpha: Float[Array, " lanes"]
    behind: Float[Array, "channels lanes"]
    behind_transmittance: Float[Array, " lanes"]


def _added_color(
    samples: LayeredSamples,
    masks: LayerMasks,
    triangle: Int[Array, " lanes"],
    sample: Sample,
    tiling: Tiling,
) -> Float[Array, "channels lanes"]:
    """Colour of each sample with all its layers, minus its colour without one of them.

    Both are premultiplied colours over the background. `triangle` is the triangle of this layer,
    one for each sample.
    """
    background = samples.background
    where = locate_layers(masks, sample, tiling)

    def visit_plane(plane: Int[Array, ""], layers: _Layers) -> _Layers:
        mask = gather_masks(masks, where.mask_index, plane)

        def visit(
            layers: _Layers, other: Int[Array, " lanes"], remaining: UInt32[Array, " lanes"]
        ) -> _Layers:
            rgba = samples.colors.at_each(other, sample, tiling)
            return _add_layer(layers, rgba, other - triangle, remaining != 0)

        return visit_layers(mask, where, samples.lists, plane, visit, layers)

    clear = jnp.ones(triangle.shape, background.dtype)
    black = jnp.zeros((background.shape[0], *triangle.shape), background.dtype)
    layers = _Layers(clear, black, jnp.zeros_like(clear), black, clear)
    layers = repeat(count_planes(masks), visit_plane, layers)
    return materialized(_over_behind)(layers, background)


@materialized
def _add_layer(
    layers: _Layers,
    rgba: Float[Array, "4 lanes"],
    draws_ahead: Int[Array, " lanes"],
    is_layer: Bool[Array, " lanes"],
) -> _Layers:
    """Add the next layer from the front to that part of `layers` to which it belongs.

    - `rgba`: premultiplied colour and alpha of the layer.
    - `draws_ahead`: index of the layer's triangle minus the index of the triangle at which `layers`
      are split: positive in front of this triangle, 0 for the triangle itself, negative behind it.
    - `is_layer`: false for samples without a further layer, which stay unchanged.
    """
    color, alpha = rgba[: layers.color.shape[0]], rgba[3]
    is_in_front = is_layer & (draws_ahead > 0)
    is_triangle = is_layer & (draws_ahead == 0)
    is_behind = is_layer & (draws_ahead < 0)
    return _Layers(
        layers.in_front * jnp.where(is_in_front, 1.0 - alpha, 1.0),
        jnp.where(is_triangle[None], color, layers.color),
        jnp.where(is_triangle, alpha, layers.alpha),
        layers.behind + jnp.where(is_behind, layers.behind_transmittance, 0.0)[None] * color,
        layers.behind_transmittance * jnp.where(is_behind, 1.0 - alpha, 1.0),
    )


def _over_behind(
    layers: _Layers, background: Float[Array, " channels"]
) -> Float[Array, "channels lanes"]:
    """Compute each sample's colour with all `layers`, minus its colour without the triangle.

    The triangle is the one at which the layers are split (`_Layers`).
    """
    under = layers.behind + layers.behind_transmittance[None] * background[:, None]
    return layers.in_front[None] * (layers.color - layers.alpha[None] * under)
