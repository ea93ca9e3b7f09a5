"""Mix triangles by depth: the aggregation of Soft Rasterizer, which has a gradient by depth too.

For the triangles at a pixel, with opacity a_i, colour c_i and depth z_i, the colour is the mean
with the weights a_i exp(-z_i / temperature), and their joint opacity is 1 - prod_i (1 - a_i). The
background is visible with the remaining weight, so that a single triangle is drawn as without
depth. (In the paper the background has its own weight among the others, and a depth.)

**Source:** Liu, Li, Chen and Li, *Soft Rasterizer* (ICCV 2019), section 3.3, equations 2 to 5.
"""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..binning.lists import Chunks
from ..numerics import safe
from ..numerics.fusion_barrier import materialized
from .analytic_over import composite
from .opaque import sum_chunks

_LEAST = -80.0
"""Logarithm of a weight that is negligible beside a weight of 1."""


def mix(
    opacity: Float[Array, "chunks layers pixels"],
    colors: Float[Array, "chunks layers 3 #pixels"],
    depth: Float[Array, "chunks layers pixels"],
    temperature: Float[Array, ""],
    chunks: Chunks,
    *,
    max_chunks: int,
) -> Float[Array, "4 tiles pixels"]:
    """Compute the premultiplied colour and alpha of each pixel.

    `max_chunks` is an upper bound on the number of chunks of a tile.
    """
    nearest, reference = _nearest(*jax.lax.stop_gradient((opacity, depth, colors)), chunks)

    @materialized
    def weigh(opacity, colors, depth, temperature, nearest, reference, chunks):
        # Depth is relative to the nearest visible triangle: the common factor cancels, and no
        # weight is infinite.
        gap = nearest[chunks.tile][:, None] - depth
        # A clip instead of `where` would halve the gradient of the nearest triangle itself. The
        # test precedes the division, so that the vjp never multiplies an infinity by zero.
        counts = (opacity > 0) & (gap > _LEAST * temperature)
        # The others weigh nothing at all: a weight of exp(-80) has a derivative by depth, which a
        # low temperature and a large depth make large.
        power = jnp.where(counts, gap, 0.0) / temperature
        weight = jnp.where(counts, opacity, 0.0) * jnp.exp(power)
        # Colours are relative to a constant that cancels. Where one triangle has all the weight,
        # the mean is its colour, and a rounding of this colour must not be multiplied by the
        # gradient by a large depth.
        terms = [
            weight * (colors[:, :, channel] - reference[channel][chunks.tile][:, None])
            for channel in range(3)
        ]
        terms.append(weight)
        return [
            functools.reduce(jnp.add, [term[:, k] for k in range(term.shape[1])]) for term in terms
        ]

    terms = weigh(opacity, colors, depth, temperature, nearest, reference, chunks)
    sums = [
        sum_chunks(term[:, None, None], chunks, max_chunks=max_chunks)[:, 0, 0] for term in terms
    ]
    alpha = composite(opacity, jnp.zeros_like(colors), chunks, max_chunks=max_chunks)[3]

    @materialized
    def divide(sums, alpha, reference):
        # The derivative of a quotient divides by the square of the weight, which may underflow.
        # Both sides are first scaled by a constant, so that the divisor is near 1.
        scale = jax.lax.stop_gradient(safe.divide(jnp.ones_like(alpha), sums[3]))
        total = sums[3] * scale
        mean = [
            offset + safe.divide(difference * scale, total)
            for offset, difference in zip(reference, sums[:3], strict=True)
        ]
        return jnp.stack([*(offset * alpha for offset in mean), alpha])

    return divide(sums, alpha, reference)


def _nearest(
    opacity: Array, depth: Array, colors: Array, chunks: Chunks
) -> tuple[Float[Array, "tiles pixels"], list[Float[Array, "tiles pixels"]]]:
    """Find the depth and colour of the nearest visible triangle; 0 where there is none.

    If several are at the same depth, each colour channel is that of any of them.
    """

    @materialized
    def look(opacity, depth, colors):
        least = jnp.full_like(depth[:, 0], jnp.inf)
        nearest_color = [jnp.zeros_like(least)] * 3
        for k in range(depth.shape[1]):
            nearer = (opacity[:, k] > 0) & (depth[:, k] < least)
            least = jnp.where(nearer, depth[:, k], least)
            nearest_color = [
                jnp.where(nearer, colors[:, k, c], previous)
                for c, previous in enumerate(nearest_color)
            ]
        return least, nearest_color

    @materialized
    def join(chunk_depth, colors, chunks):
        number = jnp.arange(chunks.tile.shape[0], dtype=jnp.int32)
        tile = jnp.where(number < chunks.needed, chunks.tile, chunks.count.shape[0])
        empty = jnp.full((chunks.count.shape[0], chunk_depth.shape[1]), jnp.inf, chunk_depth.dtype)
        least = empty.at[tile].min(chunk_depth, mode="drop")
        is_nearest = chunk_depth == least[chunks.tile]
        # An infinity would be multiplied by zero in the vjp.
        return [
            jnp.where(least < jnp.inf, entry, 0.0)
            for entry in (
                least,
                *(
                    empty.at[tile].min(jnp.where(is_nearest, color, jnp.inf), mode="drop")
                    for color in colors
                ),
            )
        ]

    nearest, *reference = join(*look(opacity, depth, colors), chunks)
    return nearest, reference
