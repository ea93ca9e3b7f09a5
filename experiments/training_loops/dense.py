"""A dense soft rasterizer in `jax.numpy`: every triangle is computed at every pixel.

Users with few triangles write such a rasterizer by hand: no tiles, no lists, no plan. Coverage is
the sigmoid of the signed distance from the centre of a pixel to the triangle, and triangles are
composited in draw order.

Of six implementations that were timed on two cores, this one was the fastest with 30 triangles, by
a factor of two or more at 64 and 128 pixels. It draws one triangle after another, and computes the
coverage again in the backward pass (`jax.checkpoint`) instead of storing it. The other
implementations stored the coverage of all triangles, `[triangles, height, width]`, which fills the
cache. With 8 triangles at 28 pixels, this implementation was within a tenth of the fastest.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

_LOGIT = math.log(9.0)
"""Argument at which the sigmoid is 0.9. A width is the distance between 0.1 and 0.9."""


def render(
    corners: Float[Array, "triangles 3 2"],
    colors: Float[Array, "triangles 3"],
    *,
    size: int,
    width: float,
) -> Float[Array, "size size 3"]:
    """Image of opaque flat triangles over white; later ones lie in front."""
    x = jnp.arange(size) + 0.5
    y = x[:, None]

    @jax.checkpoint
    def put_over(image, triangle):
        corner, color = triangle
        opacity = jax.nn.sigmoid(signed_distance(corner, x, y) * (2 * _LOGIT / width))
        return image + opacity * (color[:, None, None] - image), None

    image, _ = jax.lax.scan(put_over, jnp.ones((3, size, size)), (corners, colors))
    return jnp.moveaxis(image, 0, -1)


def signed_distance(
    corners: Float[Array, "3 2"], x: Float[Array, " columns"], y: Float[Array, "rows 1"]
) -> Float[Array, "rows columns"]:
    """Euclidean distance, in pixels, from points to the outline of a triangle, positive inside."""
    squared, crosses = [], []
    for k in range(3):
        (ax, ay), (bx, by) = corners[k], corners[(k + 1) % 3]
        ex, ey, ox, oy = bx - ax, by - ay, x - ax, y - ay
        # The nearest point of a collapsed edge is its first end.
        t = jnp.clip((ox * ex + oy * ey) / jnp.maximum(ex * ex + ey * ey, 1e-12), 0.0, 1.0)
        squared.append((ox - t * ex) ** 2 + (oy - t * ey) ** 2)
        crosses.append(ex * oy - ey * ox)
    # One square root for all three edges; its argument is kept away from zero.
    distance = jnp.sqrt(jnp.maximum(jnp.minimum(jnp.minimum(*squared[:2]), squared[2]), 1e-12))
    cross = jnp.stack(crosses)
    is_inside = (cross >= 0).all(0) | (cross <= 0).all(0)
    return jnp.where(is_inside, distance, -distance)
