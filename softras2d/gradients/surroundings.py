"""What lies in front of the triangle of an edge and behind it, at the crossings of the edge.

The loops over layers (`layer_visits`) add one layer after another to `Surroundings`. For a jvp, all
channels of the colour behind the edge's triangle are needed. For a vjp, its dot product with the
cotangent of the crossing's pixel is enough, which is one number. Both are called the `values` of
the colour.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

PixelCotangent = Float[Array, "channels lines runs"] | None
"""The cotangent of the pixel of each crossing. If it is None, `values` of a colour are its
channels; else they are one number, the dot product of the colour and this cotangent."""


class Behind(NamedTuple):
    """The visited layers behind the edge's triangle, composited without a background.

    - `values`: values of their premultiplied colour (`values_of`).
    - `transmittance`: their transmittance.
    """

    values: Float[Array, "values lines runs"]
    transmittance: Float[Array, "lines runs"]


class Surroundings(NamedTuple):
    """What the visited layers of the two samples beside each crossing add up to.

    - `in_front_outside`: transmittance of the layers in front of the edge's triangle at the sample
      outside.
    - `in_front_inside`: the same at the sample inside. It lacks those layers that `layers_inside`
      visits later.
    - `behind`: layers that are visible behind the edge's triangle at the sample outside.
    - `hidden`: whether a layer of the sample outside that is drawn earlier lies nearer, so that the
      edge's triangle fails the depth test there. It is None without depth.
    - `if_absent`: layers of the sample outside that would be visible without the edge's triangle,
      except those in front of it. It is None without depth, where it would equal `behind`.
    """

    in_front_outside: Float[Array, "lines runs"]
    in_front_inside: Float[Array, "lines runs"]
    behind: Behind
    hidden: Bool[Array, "lines runs"] | None
    if_absent: Behind | None


def no_layers(
    shape: tuple[int, ...], values: int, dtype: jnp.dtype, *, has_depth: bool
) -> Surroundings:
    """Return the surroundings before any layer is visited; `shape` is `(lines, runs)`.

    `values` is the number of values of a colour.
    """
    clear = jnp.ones(shape, dtype)
    behind = Behind(jnp.zeros((values, *shape), dtype), clear)
    if not has_depth:
        return Surroundings(clear, clear, behind, None, None)
    return Surroundings(clear, clear, behind, jnp.zeros(shape, bool), behind)


def still_matter(state: Surroundings) -> Bool[Array, "lines runs"]:
    """Whether further layers in front of the edge's triangle could noticeably change its gain.

    They could unless the layers visited so far hide the triangle already (`is_noticeable`). `state`
    has what these layers add up to.
    """
    return is_noticeable(jnp.minimum(state.in_front_outside, state.in_front_inside))


def still_matter_behind(state: Surroundings) -> Bool[Array, "lines runs"]:
    """Whether further layers behind the edge's triangle could noticeably change its gain.

    They could unless the layers in front, and those visited behind, hide them (`is_noticeable`).
    """
    in_front = jnp.minimum(state.in_front_outside, state.in_front_inside)
    return is_noticeable(in_front * state.behind.transmittance)


def is_noticeable(transmittance: Float[Array, "*samples"]) -> Bool[Array, "*samples"]:
    """Whether a layer behind this transmittance is noticed: whether it is eps^2 or more.

    With eps, the distance from 1 to the next larger float, eps^2 is 1.4e-14 in float32. The image
    itself is rounded to about eps.
    """
    return transmittance >= float(jnp.finfo(transmittance.dtype).eps) ** 2


def values_of(
    color: Float[Array, "_ #lines #runs"], cotangent: PixelCotangent
) -> Float[Array, "values #lines #runs"]:
    """Return the values of a premultiplied colour: its channels, or one dot product.

    Channels of `color` beyond those of the cotangent are not used.
    """
    if cotangent is None:
        return color
    channels = [cotangent[k] * color[k] for k in range(cotangent.shape[0])]
    return sum(channels[1:], channels[0])[None]


def add_behind(
    behind: Behind,
    values: Float[Array, "_ #lines runs"],
    alpha: Float[Array, "#lines runs"],
    is_behind: Bool[Array, "lines runs"],
) -> Behind:
    """Composite a layer behind the layers in `behind`, where `is_behind`.

    `values` are the values of its premultiplied colour (`values_of`). Channels that the image does
    not have are ignored.
    """
    visible = jnp.where(is_behind, behind.transmittance, 0.0)
    return Behind(
        behind.values + visible[None] * values[: behind.values.shape[0]],
        behind.transmittance * jnp.where(is_behind, 1.0 - alpha, 1.0),
    )


def over_background(
    behind: Behind, background: Float[Array, " channels"], cotangent: PixelCotangent
) -> Float[Array, "values lines runs"]:
    """Composite the layers in `behind` over the premultiplied background, as values of a colour."""
    below = values_of(background[:, None, None], cotangent)
    return behind.values + behind.transmittance[None] * below
