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

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from ..coverage.pixels import sum_pixels
from ..linear import linear_map
from ..lists import Chunks
from ..staging import one_pass

_UNROLLED = 16
"""Chunks of a tile that are gone through in one expression; more take a loop."""


def composite(
    opacity: Float[Array, "chunks layers pixels"],
    colors: Float[Array, "chunks layers 3 #pixels"],
    chunks: Chunks,
    *,
    depth: int,
) -> Float[Array, "4 tiles pixels"]:
    """Premultiplied colour and alpha of each pixel, without background.

    Opacity is coverage times alpha, 0 in slots that are not filled; `depth` bounds the chunks of a
    tile.
    """
    return _composite(depth, opacity, colors, chunks)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _composite(depth: int, opacity: Array, colors: Array, chunks: Chunks) -> Array:
    return _forward(depth, opacity, colors, chunks, 1.0)


@functools.partial(_composite.defjvp, symbolic_zeros=True)
def _composite_jvp(depth, primals, tangents):
    opacity, colors, chunks = primals
    out = _composite(depth, opacity, colors, chunks)
    change = jnp.zeros_like(out)
    if not isinstance(tangents[0], SymbolicZero):

        def by_opacity(fixed, moved):
            opacity, colors, chunks = fixed

            def of(opacity):
                return _forward(depth, opacity, colors, chunks, 1.0)

            return jax.jvp(of, (opacity,), (moved,))[1]

        def to_opacity(fixed, weight):
            opacity, colors, chunks = fixed
            return _opacity_weights(depth, opacity, colors, chunks, weight)

        change = linear_map(by_opacity, to_opacity)(primals, tangents[0])
    if not isinstance(tangents[1], SymbolicZero):

        def by_color(fixed, moved):
            opacity, _, chunks = fixed
            return _forward(depth, opacity, moved, chunks, 0.0)

        def to_color(fixed, weight):
            opacity, colors, chunks = fixed
            return _color_weights(depth, opacity, colors, chunks, weight)

        change = change + linear_map(by_color, to_color)(primals, tangents[1])
    return out, change


def _forward(
    depth: int, opacity: Array, colors: Array, chunks: Chunks, solid: float
) -> Float[Array, "4 tiles pixels"]:
    """The composite; `solid` stands for the alpha of a layer, 1, or 0 for a change of colours."""
    layers = opacity.shape[1]

    @one_pass
    def blend(opacity, colors):
        through = jnp.ones_like(opacity[:, 0])
        sums = [jnp.zeros_like(through)] * 4
        for k in range(layers):
            seen = through * opacity[:, k]
            shown = [*(colors[:, k, channel] for channel in range(3)), solid]
            sums = [total + seen * color for total, color in zip(sums, shown, strict=True)]
            through = through * (1.0 - opacity[:, k])
        return sums, 1.0 - through

    @one_pass
    def join(sums, covered, chunks):
        def add(k, state):
            through, total = state
            there = (k < chunks.count)[:, None]
            place = chunks.first + k
            part = [jnp.where(there, s.at[place].get(mode="clip"), 0.0) for s in sums]
            rest = jnp.where(there, 1.0 - covered.at[place].get(mode="clip"), 1.0)
            return through * rest, [t + through * p for t, p in zip(total, part, strict=True)]

        shape = (chunks.count.shape[0], opacity.shape[2])
        state = jnp.ones(shape, opacity.dtype), [jnp.zeros(shape, opacity.dtype)] * 4
        if depth <= _UNROLLED:
            for k in range(depth):
                state = add(k, state)
        else:
            state = jax.lax.fori_loop(0, jnp.max(chunks.count), add, state)
        return jnp.stack(state[1])

    sums, covered = blend(opacity, colors)
    return join(sums, covered, chunks)


def _in_front(depth: int, opacity: Array, chunks: Chunks) -> tuple[Array, Array]:
    """What each chunk covers, and the transmittance of the chunks in front of it."""
    layers = opacity.shape[1]

    @one_pass
    def cover(opacity):
        through = 1.0 - opacity[:, 0]
        for k in range(1, layers):
            through = through * (1.0 - opacity[:, k])
        return 1.0 - through

    @one_pass
    def look(covered, chunks):
        def add(j, through):
            rest = jnp.where((chunks.index >= j)[:, None], 1.0 - _shift(covered, j), 1.0)
            return through * rest

        return _through_chunks(depth, chunks, add, jnp.ones_like(covered))

    covered = cover(opacity)
    return covered, look(covered, chunks)


def _through_chunks(depth: int, chunks: Chunks, add, state):
    """`add(j, state)` for each distance j between chunks of a tile."""
    if depth <= _UNROLLED:
        for j in range(1, depth):
            state = add(j, state)
        return state
    return jax.lax.fori_loop(1, jnp.max(chunks.count), add, state)


def _shift(x: Array, j) -> Array:
    """Entry i - j at place i; its ends mean nothing."""
    return jnp.roll(x, j, 0)


def _opacity_weights(
    depth: int, opacity: Array, colors: Array, chunks: Chunks, weight: Array
) -> Float[Array, "chunks layers pixels"]:
    """The transpose of the change by opacities."""
    layers = opacity.shape[1]

    @one_pass
    def meet(colors, weight, chunks):
        total = weight[3][chunks.tile][:, None]
        for channel in range(3):
            total = total + colors[:, :, channel] * weight[channel][chunks.tile][:, None]
        return total

    @one_pass
    def blend(opacity, met):
        through, total = jnp.ones_like(opacity[:, 0]), jnp.zeros_like(opacity[:, 0])
        for k in range(layers):
            total = total + through * opacity[:, k] * met[:, k]
            through = through * (1.0 - opacity[:, k])
        return total

    @one_pass
    def look_behind(covered, total, chunks):
        last = chunks.count[chunks.tile] - 1

        def add(j, state):
            through, behind = state
            there = (chunks.index + j <= last)[:, None]
            rest = jnp.where(there, 1.0 - _shift(covered, -j), 1.0)
            return through * rest, behind + jnp.where(there, through * _shift(total, -j), 0.0)

        state = jnp.ones_like(covered), jnp.zeros_like(covered)
        return _through_chunks(depth, chunks, add, state)[1]

    @one_pass
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
    covered, through = _in_front(depth, opacity, chunks)
    behind = look_behind(covered, blend(opacity, met), chunks)
    return differ(opacity, met, through, behind, chunks)


def _color_weights(
    depth: int, opacity: Array, colors: Array, chunks: Chunks, weight: Array
) -> Float[Array, "chunks layers 3 #pixels"]:
    """The transpose of the change by colours."""
    layers, flat = opacity.shape[1], colors.shape[3] == 1

    @one_pass
    def see(opacity, through):
        seen = []
        for k in range(layers):
            seen.append(through * opacity[:, k])
            through = through * (1.0 - opacity[:, k])
        return jnp.stack(seen, 1)

    @one_pass
    def gather(seen, weight, chunks):
        parts = [seen * weight[channel][chunks.tile][:, None] for channel in range(3)]
        if not flat:
            return jnp.stack(parts, 2)
        rows = [part.reshape(-1, part.shape[2]) for part in parts]
        return jnp.stack(sum_pixels(*rows), -1).reshape(colors.shape)

    _, through = _in_front(depth, opacity, chunks)
    return gather(see(opacity, through), weight, chunks)
