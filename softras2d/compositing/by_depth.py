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

from .. import safe
from ..lists import Chunks
from ..staging import one_pass
from .fading import composite
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
    most: int,
) -> Float[Array, "4 tiles pixels"]:
    """Premultiplied colour and alpha of each pixel; `most` bounds the chunks of a tile."""
    nearest = _nearest(*jax.lax.stop_gradient((opacity, depth)), chunks)

    @one_pass
    def weigh(opacity, colors, depth, temperature, nearest, chunks):
        # From the nearest that shows on: the common factor cancels, and no weight is infinite.
        power = (nearest[chunks.tile][:, None] - depth) / temperature
        # Not by a clip, which halves the slope of the nearest itself.
        power = jnp.where((opacity > 0) & (power > _LEAST), power, _LEAST)
        weight = opacity * jnp.exp(power)
        parts = [weight * colors[:, :, channel] for channel in range(3)] + [weight]
        return [
            functools.reduce(jnp.add, [part[:, k] for k in range(part.shape[1])]) for part in parts
        ]

    parts = weigh(opacity, colors, depth, temperature, nearest, chunks)
    sums = [sum_chunks(part[:, None, None], chunks, depth=most)[:, 0, 0] for part in parts]
    alpha = composite(opacity, jnp.zeros_like(colors), chunks, depth=most)[3]

    @one_pass
    def divide(sums, alpha):
        return jnp.stack([*(safe.divide(total, sums[3]) * alpha for total in sums[:3]), alpha])

    return divide(sums, alpha)


def _nearest(opacity: Array, depth: Array, chunks: Chunks) -> Float[Array, "tiles pixels"]:
    """Depth of the nearest triangle that shows, 0 for none."""

    @one_pass
    def look(opacity, depth):
        return jnp.min(jnp.where(opacity > 0, depth, jnp.inf), 1)

    @one_pass
    def join(found, chunks):
        number = jnp.arange(chunks.tile.shape[0], dtype=jnp.int32)
        tile = jnp.where(number < chunks.needed, chunks.tile, chunks.count.shape[0])
        none = jnp.full((chunks.count.shape[0], found.shape[1]), jnp.inf, found.dtype)
        least = none.at[tile].min(found, mode="drop")
        # An infinity would meet a zero backwards.
        return jnp.where(least < jnp.inf, least, 0.0)

    return join(look(opacity, depth), chunks)
