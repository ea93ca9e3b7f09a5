"""Pixels of triangles that cover them in part: "over" with coverage times alpha, nearest first.

With opacity a_i, colour c_i and transmittance T_i = prod_{j<i} (1 - a_j) in front, a pixel is
sum_i T_i a_i c_i. Its derivative by a_i is T_i (c_i - b_i), where b_i is the composite of all that
lies behind i: no division by 1 - a_i, which may be zero. Backwards, colours meet the cotangent g of
the pixel first: b_i . g is one number, composited like a colour from the numbers c_i . g.

A tile's list is cut into chunks of a few slots. A chunk is composited by itself, and then the
chunks of the tile as if they were layers.

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
from ..coverage.analytic import sum_pixels
from ..numerics.fusion_barrier import materialized
from ..numerics.linear_map import linear_map

_UNROLLED = 16
"""Chunks of a tile that are gone through in one expression; more take a loop."""


def composite(
    opacity: Float[Array, "chunks layers pixels"],
    colors: Float[Array, "chunks layers 3 #pixels"],
    chunks: Chunks,
    *,
    max_chunks: int,
) -> Float[Array, "4 tiles pixels"]:
    """Premultiplied colour and alpha of each pixel, without background.

    Opacity is coverage times alpha, 0 in empty slots; `max_chunks` bounds the chunks of a tile.
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
    """The colour of each chunk by itself, channel by channel."""
    through = jnp.ones_like(opacity[:, 0])
    sums = [jnp.zeros_like(through)] * 3
    for k in range(opacity.shape[1]):
        seen = through * opacity[:, k]
        sums = [total + seen * colors[:, k, channel] for channel, total in enumerate(sums)]
        through = through * (1.0 - opacity[:, k])
    return sums


@materialized
def _blend_change(opacity: Array, moved: Array, colors: Array) -> list[Array]:
    """What `moved` opacities do to it."""
    through, drop = jnp.ones_like(opacity[:, 0]), jnp.zeros_like(opacity[:, 0])
    sums = [drop] * 3
    for k in range(opacity.shape[1]):
        seen = drop * opacity[:, k] + through * moved[:, k]
        sums = [total + seen * colors[:, k, channel] for channel, total in enumerate(sums)]
        clear = 1.0 - opacity[:, k]
        drop, through = drop * clear - through * moved[:, k], through * clear
    return sums


@materialized
def _cover(opacity: Array) -> Array:
    """What each chunk covers."""
    through = 1.0 - opacity[:, 0]
    for k in range(1, opacity.shape[1]):
        through = through * (1.0 - opacity[:, k])
    return 1.0 - through


@materialized
def _cover_change(opacity: Array, moved: Array) -> Array:
    through, gain = jnp.ones_like(opacity[:, 0]), jnp.zeros_like(opacity[:, 0])
    for k in range(opacity.shape[1]):
        clear = 1.0 - opacity[:, k]
        gain, through = gain * clear + through * moved[:, k], through * clear
    return gain


def _join(
    max_chunks: int, sums: list[Array], covered: Array, chunks: Chunks
) -> Float[Array, "4 tiles pixels"]:
    """The chunks of each tile as layers."""

    @materialized
    def join(sums, covered, chunks):
        def add(k, state):
            through, total = state
            (*part, own) = _of_chunk(k, [*sums, covered], chunks)
            total = [t + through * p for t, p in zip(total, part, strict=True)]
            return through * (1.0 - own), total

        shape = (chunks.count.shape[0], covered.shape[1])
        start = jnp.ones(shape, covered.dtype), [jnp.zeros(shape, covered.dtype)] * 3
        through, total = _through_tile(max_chunks, chunks, add, start)
        return jnp.stack([*total, 1.0 - through])

    return join(sums, covered, chunks)


def _join_change(
    max_chunks: int,
    sums: list[Array],
    covered: Array,
    changes: list[Array],
    gained: Array,
    chunks: Chunks,
) -> Float[Array, "4 tiles pixels"]:
    @materialized
    def join(sums, covered, changes, gained, chunks):
        def add(k, state):
            through, drop, total = state
            held = _of_chunk(k, [*sums, covered, *changes, gained], chunks)
            part, own, moved, gain = held[:3], held[3], held[4:7], held[7]
            total = [t + drop * p + through * m for t, p, m in zip(total, part, moved, strict=True)]
            return through * (1.0 - own), drop * (1.0 - own) - through * gain, total

        zero = jnp.zeros((chunks.count.shape[0], covered.shape[1]), covered.dtype)
        start = jnp.ones_like(zero), zero, [zero] * 3
        _, drop, total = _through_tile(max_chunks, chunks, add, start)
        return jnp.stack([*total, -drop])

    return join(sums, covered, changes, gained, chunks)


def _of_chunk(k: Any, entries: list[Array], chunks: Chunks) -> list[Array]:
    """The entries of chunk k of each tile, 0 where there is none."""
    there = (k < chunks.count)[:, None]
    place = chunks.first + k
    return [jnp.where(there, entry.at[place].get(mode="clip"), 0.0) for entry in entries]


def _through_tile(
    max_chunks: int, chunks: Chunks, add: Callable[[Any, Any], Any], state: Any
) -> Any:
    """`add(k, state)` for each chunk k of a tile."""
    if max_chunks <= _UNROLLED:
        for k in range(max_chunks):
            state = add(k, state)
        return state
    return jax.lax.fori_loop(0, jnp.max(chunks.count), add, state)


def _in_front(max_chunks: int, covered: Array, chunks: Chunks) -> Array:
    """The transmittance of the chunks in front of each chunk."""

    @materialized
    def look(covered, chunks):
        def add(j, through):
            rest = jnp.where((chunks.index >= j)[:, None], 1.0 - _shift(covered, j), 1.0)
            return through * rest

        return _through_chunks(max_chunks, chunks, add, jnp.ones_like(covered))

    return look(covered, chunks)


def _through_chunks(max_chunks: int, chunks: Chunks, add, state):
    """`add(j, state)` for each distance j between chunks of a tile."""
    if max_chunks <= _UNROLLED:
        for j in range(1, max_chunks):
            state = add(j, state)
        return state
    return jax.lax.fori_loop(1, jnp.max(chunks.count), add, state)


def _shift(x: Array, j) -> Array:
    """Entry i - j at place i; its ends mean nothing."""
    return jnp.roll(x, j, 0)


def _opacity_weights(
    max_chunks: int, opacity: Array, colors: Array, covered: Array, chunks: Chunks, weight: Array
) -> Float[Array, "chunks layers pixels"]:
    """The transpose of the change by opacities."""
    layers = opacity.shape[1]

    @materialized
    def meet(colors, weight, chunks):
        total = weight[3][chunks.tile][:, None]
        for channel in range(3):
            total = total + colors[:, :, channel] * weight[channel][chunks.tile][:, None]
        return total

    @materialized
    def blend(opacity, met):
        through, total = jnp.ones_like(opacity[:, 0]), jnp.zeros_like(opacity[:, 0])
        for k in range(layers):
            total = total + through * opacity[:, k] * met[:, k]
            through = through * (1.0 - opacity[:, k])
        return total

    @materialized
    def look_behind(covered, total, chunks):
        last = chunks.count[chunks.tile] - 1

        def add(j, state):
            through, behind = state
            there = (chunks.index + j <= last)[:, None]
            rest = jnp.where(there, 1.0 - _shift(covered, -j), 1.0)
            return through * rest, behind + jnp.where(there, through * _shift(total, -j), 0.0)

        state = jnp.ones_like(covered), jnp.zeros_like(covered)
        return _through_chunks(max_chunks, chunks, add, state)[1]

    @materialized
    def differ(opacity, met, through, behind, chunks):
        front, back = [through], [behind]
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
    through = _in_front(max_chunks, covered, chunks)
    behind = look_behind(covered, blend(opacity, met), chunks)
    return differ(opacity, met, through, behind, chunks)


def _color_weights(
    max_chunks: int, opacity: Array, colors: Array, covered: Array, chunks: Chunks, weight: Array
) -> Float[Array, "chunks layers 3 #pixels"]:
    """The transpose of the change by colours."""
    layers, flat = opacity.shape[1], colors.shape[3] == 1

    @materialized
    def see(opacity, through):
        seen = []
        for k in range(layers):
            seen.append(through * opacity[:, k])
            through = through * (1.0 - opacity[:, k])
        return jnp.stack(seen, 1)

    @materialized
    def gather(seen, weight, chunks):
        parts = [seen * weight[channel][chunks.tile][:, None] for channel in range(3)]
        if not flat:
            return jnp.stack(parts, 2)
        rows = [part.reshape(-1, part.shape[2]) for part in parts]
        return jnp.stack(sum_pixels(*rows), -1).reshape(colors.shape)

    through = _in_front(max_chunks, covered, chunks)
    return gather(see(opacity, through), weight, chunks)
