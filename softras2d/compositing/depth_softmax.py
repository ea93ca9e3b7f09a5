"""Mix triangles by depth: the aggregation of Soft Rasterizer, which is differentiable by depth too.

The triangles at a pixel have opacity a_i, colour c_i and depth z_i. Their colour is the mean of the
c_i, weighted with a_i exp(-z_i / temperature). Their joint opacity is 1 - prod_i (1 - a_i), and the
background is visible through the rest. So a single triangle is drawn as without depth. (In the
paper the background has a depth, and a weight in the mean like the triangles.)

**Source:** Liu, Li, Chen and Li, *Soft Rasterizer* (ICCV 2019), section 3.3, equations 2 to 5.
"""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..binning.lists import Chunks
from ..numerics import safe
from ..numerics.fusion_barrier import materialized
from .analytic_over import composite
from .opaque import sum_chunks

_LEAST_LOG_WEIGHT = -80.0
"""A triangle is ignored if its factor exp(-z / temperature), divided by the nearest triangle's
factor, has a logarithm of this number or less."""


def mix(
    opacity: Float[Array, "chunks slots pixels"],
    colors: Float[Array, "chunks slots 3 #pixels"],
    depth: Float[Array, "chunks slots pixels"],
    temperature: Float[Array, ""],
    chunks: Chunks,
    *,
    max_chunks: int,
) -> Float[Array, "4 tiles pixels"]:
    """Mix the triangles of each pixel by depth, and return premultiplied RGBA without background.

    The straight colour is the mean of the triangles' colours, weighted with opacity times
    exp(-depth / temperature); this factor counts as 0 if it is e^-80 of the nearest triangle's, or
    less. Alpha is 1 minus the product of 1 - opacity. Where no triangle has an opacity above 0, all
    four channels are 0. Differentiable with respect to `opacity`, `colors`, `depth` and
    `temperature`; the mean's derivative with respect to an opacity of 0 is 0.

    - `opacity`: coverage times alpha, 0..1; 0 in empty slots.
    - `colors`: straight RGB; the axis of pixels has length 1 if each slot has one colour.
    - `depth`: greater is farther away, in any unit.
    - `temperature`: in the unit of depth, positive. Triangles whose depths differ by much less are
      mixed; of those that differ by much more, only the nearest counts.
    - `chunks`: the slots of each tile. A slot is a triangle in a tile, or empty.
    - `max_chunks`: upper bound on the number of chunks of a tile.
    """
    nearest, reference = _nearest(*jax.lax.stop_gradient((opacity, depth, colors)), chunks)
    chunk_sums = _sum_weighted(opacity, colors, depth, temperature, nearest, reference, chunks.tile)
    sums = [
        sum_chunks(entry[:, None, None], chunks, max_chunks=max_chunks)[:, 0, 0]
        for entry in chunk_sums
    ]
    alpha = composite(opacity, jnp.zeros_like(colors), chunks, max_chunks=max_chunks)[3]
    return _divide_by_weight(sums, alpha, reference)


@materialized
def _sum_weighted(
    opacity: Float[Array, "chunks slots pixels"],
    colors: Float[Array, "chunks slots 3 #pixels"],
    depth: Float[Array, "chunks slots pixels"],
    temperature: Float[Array, ""],
    nearest: Float[Array, "tiles pixels"],
    reference: list[Float[Array, "tiles pixels"]],
    tile: Int[Array, " chunks"],
) -> list[Float[Array, "chunks pixels"]]:
    """Sum weight times colour for each channel, and the weight, over the slots of each chunk.

    Returns four arrays: red, green, blue and weight. The weight of a slot is opacity times
    exp((`nearest` - depth) / temperature), or 0 where this exponential is e^-80 or less.

    - `nearest`: the least depth of the triangles of the tile that have an opacity above 0, in each
      pixel. Because depth is taken relative to it, no weight is infinite. The common factor
      cancels.
    - `reference`: the colour of the nearest triangle, one array per channel. Colours are taken
      relative to it, and `_divide_by_weight` adds it again. So where the nearest triangle has all
      the weight, all sums of colours are exactly 0. A rounding error in them would enter the
      gradient with respect to depth, which may multiply it by a large number.
    - `tile`: the tile of each chunk.
    """
    gap = nearest[tile][:, None] - depth
    # Clipping the gap instead would halve the gradient of the nearest triangle, whose gap is 0. The
    # test precedes the division, so that the vjp never multiplies an infinity by zero.
    counts = (opacity > 0) & (gap > _LEAST_LOG_WEIGHT * temperature)
    # All other slots get a weight of exactly 0. Even exp(-80) would have a derivative with respect
    # to depth, which a low temperature and a large depth make large.
    log_weight = jnp.where(counts, gap, 0.0) / temperature
    weight = jnp.where(counts, opacity, 0.0) * jnp.exp(log_weight)
    terms = [
        weight * (colors[:, :, channel] - reference[channel][tile][:, None]) for channel in range(3)
    ]
    terms.append(weight)
    return [functools.reduce(jnp.add, [term[:, k] for k in range(term.shape[1])]) for term in terms]


@materialized
def _divide_by_weight(
    sums: list[Float[Array, "tiles pixels"]],
    alpha: Float[Array, "tiles pixels"],
    reference: list[Float[Array, "tiles pixels"]],
) -> Float[Array, "4 tiles pixels"]:
    """Compute premultiplied RGBA from the sums of `_sum_weighted` over all chunks of each tile.

    The mean colour is the sums of colours divided by the weight, plus `reference`, the colour that
    `_sum_weighted` subtracted. It is then multiplied by `alpha`, the joint opacity of the triangles
    of a pixel.
    """
    # The derivative of a quotient divides by the square of the weight, which may underflow. So the
    # numerator and the divisor are first scaled by a constant that makes the divisor nearly 1.
    scale = jax.lax.stop_gradient(safe.divide(jnp.ones_like(alpha), sums[3]))
    total = sums[3] * scale
    mean = [
        offset + safe.divide(difference * scale, total)
        for offset, difference in zip(reference, sums[:3], strict=True)
    ]
    return jnp.stack([*(channel * alpha for channel in mean), alpha])


def _nearest(
    opacity: Float[Array, "chunks slots pixels"],
    depth: Float[Array, "chunks slots pixels"],
    colors: Float[Array, "chunks slots 3 #pixels"],
    chunks: Chunks,
) -> tuple[Float[Array, "tiles pixels"], list[Float[Array, "tiles pixels"]]]:
    """Find the depth and colour of the nearest triangle at each pixel; 0 where there is none.

    Triangles with an opacity of 0 are ignored. If several are at the same least depth, each colour
    channel is taken from one of them, not always the same one for all channels.
    """
    nearest, *reference = _nearest_of_tile(*_nearest_of_chunk(opacity, depth, colors), chunks)
    return nearest, reference


@materialized
def _nearest_of_chunk(
    opacity: Float[Array, "chunks slots pixels"],
    depth: Float[Array, "chunks slots pixels"],
    colors: Float[Array, "chunks slots 3 #pixels"],
) -> tuple[Float[Array, "chunks pixels"], list[Float[Array, "chunks pixels"]]]:
    """Find the depth and colour of the nearest slot of each chunk that has an opacity above 0.

    In a pixel without such a slot, the depth is infinite and the colour is 0.
    """
    least = jnp.full_like(depth[:, 0], jnp.inf)
    nearest_color = [jnp.zeros_like(least)] * 3
    for k in range(depth.shape[1]):
        is_nearer = (opacity[:, k] > 0) & (depth[:, k] < least)
        least = jnp.where(is_nearer, depth[:, k], least)
        nearest_color = [
            jnp.where(is_nearer, colors[:, k, c], previous)
            for c, previous in enumerate(nearest_color)
        ]
    return least, nearest_color


@materialized
def _nearest_of_tile(
    chunk_depth: Float[Array, "chunks pixels"],
    chunk_colors: list[Float[Array, "chunks pixels"]],
    chunks: Chunks,
) -> list[Float[Array, "tiles pixels"]]:
    """Find the depth and the colour channels of the nearest chunk of each tile, at each pixel.

    Returns four arrays: depth, red, green and blue. If several chunks are nearest, each channel is
    the least of theirs. All are 0 where the depth of every chunk is infinite.
    """
    number = jnp.arange(chunks.tile.shape[0], dtype=jnp.int32)
    tile = jnp.where(number < chunks.needed, chunks.tile, chunks.count.shape[0])
    infinite = jnp.full((chunks.count.shape[0], chunk_depth.shape[1]), jnp.inf, chunk_depth.dtype)
    least = infinite.at[tile].min(chunk_depth, mode="drop")
    is_nearest = chunk_depth == least[chunks.tile]
    colors = [
        infinite.at[tile].min(jnp.where(is_nearest, color, jnp.inf), mode="drop")
        for color in chunk_colors
    ]
    # An infinity would be multiplied by zero in the vjp.
    return [jnp.where(least < jnp.inf, entry, 0.0) for entry in (least, *colors)]
