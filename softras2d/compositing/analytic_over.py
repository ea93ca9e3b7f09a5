"""Composite triangles with analytic coverage: "over", nearest first, with coverage times alpha.

With opacity a_i, colour c_i and transmittance T_i = prod_{j<i} (1 - a_j) in front, a pixel is sum_i
T_i a_i c_i. Its derivative by a_i is T_i (c_i - b_i), where b_i is the composite of all layers
behind i. This needs no division by 1 - a_i, which may be zero. The vjp first takes the dot product
of the colours and the cotangent g of the pixel: b_i . g is one number, composited like a colour
from the numbers c_i . g.

A tile's list is cut into chunks of a few slots. Each chunk is composited by itself, and then the
chunks of the tile are composited like layers.

**Source:** Porter and Duff, *Compositing Digital Images* (SIGGRAPH 1984), section 4, for "over".
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from ..binning.lists import Chunks
from ..coverage.tile_sums import sum_pixels
from ..numerics.fusion_barrier import materialized
from ..numerics.linear_map import linear_map

_UNROLLED = 16
"""Maximum number of chunks of a tile that one unrolled expression processes; more take a loop."""


def composite(
    opacity: Float[Array, "chunks layers pixels"],
    colors: Float[Array, "chunks layers 3 #pixels"],
    chunks: Chunks,
    *,
    max_chunks: int,
) -> Float[Array, "4 tiles pixels"]:
    """Compute the premultiplied colour and alpha of each pixel, without background.

    Opacity is coverage times alpha, 0 in empty slots. `max_chunks` is an upper bound on the number
    of chunks of a tile.
    """
    return _composite(max_chunks, opacity, colors, chunks)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _composite(max_chunks: int, opacity: Array, colors: Array, chunks: Chunks) -> Array:
    return _join(max_chunks, _blend(opacity, colors), _cover(opacity), chunks)


@functools.partial(_composite.defjvp, symbolic_zeros=True)
def _composite_jvp(max_chunks, primals, tangents):
    opacity, colors, chunks = primals
    sums, covered = _blend(opacity, colors), _cover(opacity)
    out = _join(max_chunks, sums, covered, chunks)
    change = jnp.zeros_like(out)
    fixed = opacity, colors, chunks, sums, covered
    if not isinstance(tangents[0], SymbolicZero):

        def by_opacity(fixed, moved):
            opacity, colors, chunks, sums, covered = fixed
            changes = _blend_change(opacity, moved, colors)
            return _join_change(
                max_chunks, sums, covered, changes, _cover_change(opacity, moved), chunks
            )

        def to_opacity(fixed, weight):
            opacity, colors, chunks, _, covered = fixed
            return _opacity_weights(max_chunks, opacity, colors, covered, chunks, weight)

        change = linear_map(by_opacity, to_opacity)(fixed, tangents[0])
    if not isinstance(tangents[1], SymbolicZero):

        def by_color(fixed, moved):
            opacity, _, chunks, _, covered = fixed
            shown = _join(max_chunks, _blend(opacity, moved), covered, chunks)
            return shown.at[3].set(0.0)

        def to_color(fixed, weight):
            opacity, colors, chunks, _, covered = fixed
            return _color_weights(max_chunks, opacity, colors, covered, chunks, weight)

        change = change + linear_map(by_color, to_color)(fixed, tangents[1])
    return out, change


@materialized
def _blend(opacity: Array, colors: Array) -> list[Array]:
    """Composite each chunk by itself; the colours are separate arrays per channel."""
    transmittance = jnp.ones_like(opacity[:, 0])
    sums = [jnp.zeros_like(transmittance)] * 3
    for k in range(opacity.shape[1]):
        visible = transmittance * opacity[:, k]
        sums = [total + visible * colors[:, k, channel] for channel, total in enumerate(sums)]
        transmittance = transmittance * (1.0 - opacity[:, k])
    return sums


@materialized
def _blend_change(opacity: Array, moved: Array, colors: Array) -> list[Array]:
    """Compute the jvp of `_blend` by the opacities, with the tangent `moved`."""
    transmittance, drop = jnp.ones_like(opacity[:, 0]), jnp.zeros_like(opacity[:, 0])
    sums = [drop] * 3
    for k in range(opacity.shape[1]):
        visible = drop * opacity[:, k] + transmittance * moved[:, k]
        sums = [total + visible * colors[:, k, channel] for channel, total in enumerate(sums)]
        clear = 1.0 - opacity[:, k]
        drop, transmittance = drop * clear - transmittance * moved[:, k], transmittance * clear
    return sums


@materialized
def _cover(opacity: Array) -> Array:
    """Compute the alpha of each chunk by itself."""
    transmittance = 1.0 - opacity[:, 0]
    for k in range(1, opacity.shape[1]):
        transmittance = transmittance * (1.0 - opacity[:, k])
    return 1.0 - transmittance


@materialized
def _cover_change(opacity: Array, moved: Array) -> Array:
    """Compute the jvp of `_cover`, with the tangent `moved`."""
    transmittance, gain = jnp.ones_like(opacity[:, 0]), jnp.zeros_like(opacity[:, 0])
    for k in range(opacity.shape[1]):
        clear = 1.0 - opacity[:, k]
        gain, transmittance = gain * clear + transmittance * moved[:, k], transmittance * clear
    return gain


def _join(
    max_chunks: int, sums: list[Array], covered: Array, chunks: Chunks
) -> Float[Array, "4 tiles pixels"]:
    """Composite the chunks of each tile like layers."""

    @materialized
    def join(sums, covered, chunks):
        def add(k, state):
            transmittance, total = state
            (*chunk_colors, chunk_alpha) = _of_chunk(k, [*sums, covered], chunks)
            total = [t + transmittance * p for t, p in zip(total, chunk_colors, strict=True)]
            return transmittance * (1.0 - chunk_alpha), total

        shape = (chunks.count.shape[0], covered.shape[1])
        start = jnp.ones(shape, covered.dtype), [jnp.zeros(shape, covered.dtype)] * 3
        transmittance, total = _through_tile(max_chunks, chunks, add, start)
        return jnp.stack([*total, 1.0 - transmittance])

    return join(sums, covered, chunks)


def _join_change(
    max_chunks: int,
    sums: list[Array],
    covered: Array,
    changes: list[Array],
    gained: Array,
    chunks: Chunks,
) -> Float[Array, "4 tiles pixels"]:
    """Compute the jvp of `_join` by the colours and the alpha of the chunks."""

    @materialized
    def join(sums, covered, changes, gained, chunks):
        def add(k, state):
            transmittance, drop, total = state
            entries = _of_chunk(k, [*sums, covered, *changes, gained], chunks)
            chunk_colors, chunk_alpha, color_change, alpha_change = (
                entries[:3],
                entries[3],
                entries[4:7],
                entries[7],
            )
            total = [
                t + drop * p + transmittance * m
                for t, p, m in zip(total, chunk_colors, color_change, strict=True)
            ]
            return (
                transmittance * (1.0 - chunk_alpha),
                drop * (1.0 - chunk_alpha) - transmittance * alpha_change,
                total,
            )

        zero = jnp.zeros((chunks.count.shape[0], covered.shape[1]), covered.dtype)
        start = jnp.ones_like(zero), zero, [zero] * 3
        _, drop, total = _through_tile(max_chunks, chunks, add, start)
        return jnp.stack([*total, -drop])

    return join(sums, covered, changes, gained, chunks)


def _of_chunk(k: Any, entries: list[Array], chunks: Chunks) -> list[Array]:
    """Gather the entries of chunk k of each tile; 0 where a tile has no such chunk."""
    exists = (k < chunks.count)[:, None]
    index = chunks.first + k
    return [jnp.where(exists, entry.at[index].get(mode="clip"), 0.0) for entry in entries]


def _through_tile(
    max_chunks: int, chunks: Chunks, add: Callable[[Any, Any], Any], state: Any
) -> Any:
    """Fold `add(k, state)` over the chunks k of a tile."""
    if max_chunks <= _UNROLLED:
        for k in range(max_chunks):
            state = add(k, state)
        return state
    return jax.lax.fori_loop(0, jnp.max(chunks.count), add, state)


def _in_front(max_chunks: int, covered: Array, chunks: Chunks) -> Array:
    """Transmittance of the chunks in front of each chunk."""

    @materialized
    def look(covered, chunks):
        def add(j, transmittance):
            rest = jnp.where((chunks.index >= j)[:, None], 1.0 - _shift(covered, j), 1.0)
            return transmittance * rest

        return _through_chunks(max_chunks, chunks, add, jnp.ones_like(covered))

    return look(covered, chunks)


def _through_chunks(max_chunks: int, chunks: Chunks, add, state):
    """Fold `add(j, state)` over the distances j between chunks of a tile."""
    if max_chunks <= _UNROLLED:
        for j in range(1, max_chunks):
            state = add(j, state)
        return state
    return jax.lax.fori_loop(1, jnp.max(chunks.count), add, state)


def _shift(x: Array, j) -> Array:
    """Move entry i - j to index i; the entries that wrap around have no meaning."""
    return jnp.roll(x, j, 0)


def _opacity_weights(
    max_chunks: int, opacity: Array, colors: Array, covered: Array, chunks: Chunks, weight: Array
) -> Float[Array, "chunks layers pixels"]:
    """Compute the vjp by the opacities."""
    layers = opacity.shape[1]

    @materialized
    def meet(colors, weight, chunks):
        total = weight[3][chunks.tile][:, None]
        for channel in range(3):
            total = total + colors[:, :, channel] * weight[channel][chunks.tile][:, None]
        return total

    @materialized
    def blend(opacity, met):
        transmittance, total = jnp.ones_like(opacity[:, 0]), jnp.zeros_like(opacity[:, 0])
        for k in range(layers):
            total = total + transmittance * opacity[:, k] * met[:, k]
            transmittance = transmittance * (1.0 - opacity[:, k])
        return total

    @materialized
    def look_behind(covered, total, chunks):
        last = chunks.count[chunks.tile] - 1

        def add(j, state):
            transmittance, behind = state
            exists = (chunks.index + j <= last)[:, None]
            rest = jnp.where(exists, 1.0 - _shift(covered, -j), 1.0)
            return transmittance * rest, behind + jnp.where(
                exists, transmittance * _shift(total, -j), 0.0
            )

        state = jnp.ones_like(covered), jnp.zeros_like(covered)
        return _through_chunks(max_chunks, chunks, add, state)[1]

    @materialized
    def differ(opacity, met, transmittance, behind, chunks):
        front, back = [transmittance], [behind]
        for k in range(layers - 1):
            front.append(front[-1] * (1.0 - opacity[:, k]))
        for k in range(layers - 1, 0, -1):
            back.append(opacity[:, k] * met[:, k] + (1.0 - opacity[:, k]) * back[-1])
        used = (jnp.arange(chunks.tile.shape[0], dtype=jnp.int32) < chunks.needed)[:, None]
        back = back[::-1]
        return jnp.stack(
            [jnp.where(used, front[k] * (met[:, k] - back[k]), 0.0) for k in range(layers)], 1
        )

    met = meet(colors, weight, chunks)
    transmittance = _in_front(max_chunks, covered, chunks)
    behind = look_behind(covered, blend(opacity, met), chunks)
    return differ(opacity, met, transmittance, behind, chunks)


def _color_weights(
    max_chunks: int, opacity: Array, colors: Array, covered: Array, chunks: Chunks, weight: Array
) -> Float[Array, "chunks layers 3 #pixels"]:
    """Compute the vjp by the colours."""
    layers, flat = opacity.shape[1], colors.shape[3] == 1

    @materialized
    def see(opacity, transmittance):
        visible = []
        for k in range(layers):
            visible.append(transmittance * opacity[:, k])
            transmittance = transmittance * (1.0 - opacity[:, k])
        return jnp.stack(visible, 1)

    @materialized
    def gather(visible, weight, chunks):
        products = [visible * weight[channel][chunks.tile][:, None] for channel in range(3)]
        if not flat:
            return jnp.stack(products, 2)
        rows = [product.reshape(-1, product.shape[2]) for product in products]
        return jnp.stack(sum_pixels(*rows), -1).reshape(colors.shape)

    transmittance = _in_front(max_chunks, covered, chunks)
    return gather(see(opacity, transmittance), weight, chunks)
