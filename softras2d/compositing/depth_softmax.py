"""Triangles mixed by depth: the aggregation of Soft Rasterizer, which has a slope by depth too.

Of all triangles at a pixel, with opacity a_i, colour c_i and depth z_i, the colour is the mean with
the weights a_i exp(-z_i / temperature), and the opacity of them together is 1 - prod_i (1 - a_i).
The background shows through what remains, so that a triangle alone is drawn as without depth. (In
the paper the background has a weight of its own among the others, and a depth.)

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
"""Logarithm of a weight that is nothing beside one of 1."""


def mix(
    opacity: Float[Array, "chunks layers pixels"],
    colors: Float[Array, "chunks layers 3 #pixels"],
    depth: Float[Array, "chunks layers pixels"],
    temperature: Float[Array, ""],
    chunks: Chunks,
    *,
    max_chunks: int,
) -> Float[Array, "4 tiles pixels"]:
    """Premultiplied colour and alpha of each pixel; `max_chunks` bounds the chunks of a tile."""
    nearest, reference = _nearest(*jax.lax.stop_gradient((opacity, depth, colors)), chunks)

    @materialized
    def weigh(opacity, colors, depth, temperature, nearest, reference, chunks):
        # From the nearest that shows on: the common factor cancels, and no weight is infinite.
        gap = nearest[chunks.tile][:, None] - depth
        # Not by a clip, which halves the slope of the nearest itself; and before the division,
        # so that no infinity meets a zero backwards.
        counts = (opacity > 0) & (gap > _LEAST * temperature)
        power = jnp.where(counts, jnp.where(counts, gap, 0.0) / temperature, _LEAST)
        weight = opacity * jnp.exp(power)
        # From a constant that cancels: where one triangle takes all, nothing else moves the mean,
        # and a rounding of its own colour is not to be multiplied by the slope of a great depth.
        parts = [
            weight * (colors[:, :, channel] - reference[channel][chunks.tile][:, None])
            for channel in range(3)
        ]
        parts.append(weight)
        return [
            functools.reduce(jnp.add, [part[:, k] for k in range(part.shape[1])]) for part in parts
        ]

    parts = weigh(opacity, colors, depth, temperature, nearest, reference, chunks)
    sums = [
        sum_chunks(part[:, None, None], chunks, max_chunks=max_chunks)[:, 0, 0] for part in parts
    ]
    alpha = composite(opacity, jnp.zeros_like(colors), chunks, max_chunks=max_chunks)[3]

    @materialized
    def divide(sums, alpha, reference):
        # A weight may be so small that its square, by which a quotient's derivative divides,
        # underflows: over a constant that is as large, the quotient is of a number near 1.
        scale = jax.lax.stop_gradient(safe.divide(jnp.ones_like(alpha), sums[3]))
        total = sums[3] * scale
        mean = [
            part + safe.divide(rest * scale, total)
            for part, rest in zip(reference, sums[:3], strict=True)
        ]
        return jnp.stack([*(part * alpha for part in mean), alpha])

    return divide(sums, alpha, reference)


def _nearest(
    opacity: Array, depth: Array, colors: Array, chunks: Chunks
) -> tuple[Float[Array, "tiles pixels"], list[Float[Array, "tiles pixels"]]]:
    """Depth and colour of the nearest triangle that shows, 0 for none.

    Of several at one depth, that of any, channel by channel.
    """

    @materialized
    def look(opacity, depth, colors):
        least = jnp.full_like(depth[:, 0], jnp.inf)
        own = [jnp.zeros_like(least)] * 3
        for k in range(depth.shape[1]):
            nearer = (opacity[:, k] > 0) & (depth[:, k] < least)
            least = jnp.where(nearer, depth[:, k], least)
            own = [jnp.where(nearer, colors[:, k, c], kept) for c, kept in enumerate(own)]
        return least, own

    @materialized
    def join(found, colors, chunks):
        number = jnp.arange(chunks.tile.shape[0], dtype=jnp.int32)
        tile = jnp.where(number < chunks.needed, chunks.tile, chunks.count.shape[0])
        none = jnp.full((chunks.count.shape[0], found.shape[1]), jnp.inf, found.dtype)
        least = none.at[tile].min(found, mode="drop")
        shows = found == least[chunks.tile]
        # An infinity would meet a zero backwards.
        return [
            jnp.where(least < jnp.inf, entry, 0.0)
            for entry in (
                least,
                *(
                    none.at[tile].min(jnp.where(shows, color, jnp.inf), mode="drop")
                    for color in colors
                ),
            )
        ]

    nearest, *reference = join(*look(opacity, depth, colors), chunks)
    return nearest, reference
