"""Colour of a triangle at a point: flat or interpolated, times a texture.

The last axis of arrays is `[lanes]`: a lane is a triangle in a tile, or in a pixel of a tile.
Colours are premultiplied, `[channels, lanes]`.

With `inverse_w` q, the weights w_i of the corners become w_i q_i / sum w_j q_j, which are linear on
the triangle in space. **Source:** Heckbert and Moreton, *Interpolation for Polygon Texture Mapping
and Shading* (1991), section 4.
"""

import functools
import operator
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..color import premultiply
from ..geometry.barycentric import Weights, slot_weights, weight_sums
from ..geometry.tiling import Tiling
from ..numerics import safe
from ..numerics.fusion_barrier import materialized
from ..texture.filtering import Lookup, read_levels, tap_levels
from ..texture.level_of_detail import Footprint, choose_levels, probes
from .surface import (
    CornerAttributes,
    CornerWeights,
    Lanes,
    Points,
    Reading,
    Surface,
    Textures,
    gather_lanes,
)


def surface_lanes(
    surface: Surface, triangle: Int[Array, " lanes"], tile: Int[Array, " lanes"], tiling: Tiling
) -> Lanes:
    """Gather the attributes of a surface for lanes of triangles and tiles."""

    @materialized
    def weigh(surface, triangle, tile):
        edges, area, planes = surface[:3]
        return slot_weights(edges, area, triangle, tile, tiling, planes)

    weights = weigh(surface, triangle, tile)
    corners, texture = gather_lanes((surface.corners, surface.texture), triangle)
    reading = None
    if surface.textures is not None and corners.inverse_w is None:
        # An affine map has one footprint for all points of a triangle.
        reading = _read_lanes(surface.textures, weights, corners, texture, None, tiling)
    return Lanes(weights, corners, texture, reading)


def add_shade(
    total: Float[Array, "channels lanes"],
    surface: Surface,
    lanes: Lanes,
    points: Points,
    tiling: Tiling,
    *,
    shown: Bool[Array, " lanes"] | None = None,
    probe: Int[Array, ""] | int = 0,
) -> Float[Array, "channels lanes"]:
    """Add the premultiplied colour of each lane's triangle at a point to `total`, where `shown`.

    There are `surface.channels` channels. With several probes the colour is the contribution of one
    of them; the caller adds those of `probe` in `0..filter.anisotropy - 1`. The addition happens
    here so that the texels read are not stored.
    """
    at = materialized(_weights_at)(lanes.weights, lanes.corners.inverse_w, points)
    read = level_chooser(surface, lanes, at, tiling)
    return add_color(
        total, at, lanes.corners, lanes.texture, surface.textures, read, shown=shown, probe=probe
    )


def level_chooser(
    surface: Surface, lanes: Lanes, at: CornerWeights, tiling: Tiling
) -> Callable[[Array], Reading | None]:
    """Make the function from (u, v) to how the texture is sampled there.

    `at` has the weights of the corners at the points.
    """

    def read(uv: Array) -> Reading | None:
        if lanes.reading is not None or surface.textures is None:
            return lanes.reading
        seen = (at, uv)
        return _read_lanes(
            surface.textures, lanes.weights, lanes.corners, lanes.texture, seen, tiling
        )

    return read


def add_color(
    total: Float[Array, "channels *points"],
    at: CornerWeights,
    corners: CornerAttributes,
    texture: Int[Array, "*lanes"] | None,
    textures: Textures | None,
    read: Callable[[Array], Reading | None],
    *,
    shown: Bool[Array, "*points"] | None = None,
    probe: Int[Array, ""] | int = 0,
) -> Float[Array, "channels *points"]:
    """Add the premultiplied colour to `total`, from the weights `at` of the corners at each point.

    `read` gives, for (u, v), how the texture is sampled there. The other arguments are those of
    `add_shade`.
    """

    def add(total, shown, color):
        return total + (color if shown is None else jnp.where(shown[None], color, 0.0))

    color = corners.color
    # A single corner is not copied.
    color = color[0] if color.shape[0] == 1 else materialized(mix)(at, color)
    if textures is None:
        return materialized(lambda t, s, c: add(t, s, premultiply(c, axis=0)))(total, shown, color)
    assert corners.uv is not None and texture is not None
    with jax.named_scope("texture"):
        uv = materialized(mix)(at, corners.uv)
        reading = read(uv)
        assert reading is not None
        uv, share = _probe(uv, reading, jnp.asarray(probe))
        lookup = Lookup(textures.filter.pixel, textures.pyramid.border, textures.pyramid.addressing)

        @materialized
        def finish(total, shown, color, texels, taps, texture, share):
            return add(total, shown, _tint(color, read_levels(texels, taps), texture, share))

        taps = tap_levels(reading.levels, uv, lookup)
        return finish(total, shown, color, textures.texels, taps, texture, share)


def shade(
    surface: Surface, lanes: Lanes, points: Points, tiling: Tiling
) -> Float[Array, "channels lanes"]:
    """Compute the premultiplied colour at a point, over all probes.

    The vjp computes each probe again instead of storing it.
    """

    def visit(total: Array, probe: Array) -> tuple[Array, None]:
        return add_shade(total, surface, lanes, points, tiling, probe=probe), None

    shape = (surface.channels, points.across.shape[0])
    probes = jnp.arange(surface.filter.anisotropy, dtype=jnp.int32)
    total = jnp.zeros(shape, surface.corners.color.dtype)
    return jax.lax.scan(jax.checkpoint(visit), total, probes)[0]


def _weights_at(weights: Weights, inverse_w: Array | None, points: Points) -> CornerWeights:
    """Weights of the corners at points."""
    count, across, down = points
    if count is None:
        first, second, third = weight_sums(weights, jnp.ones_like(across), across, down)
    else:
        number = count.astype(weights.per_value.dtype)
        sums = weight_sums(weights, count, across, down)
        first, second, third = (total / number for total in sums)
    return perspective_weights((first, second, third), inverse_w)


def perspective_weights(weights: CornerWeights, inverse_w: Array | None) -> CornerWeights:
    """Convert weights on the screen to weights on the triangle in space."""
    first, second, third = weights
    if inverse_w is None:
        return weights
    first, second, third = first * inverse_w[0], second * inverse_w[1], third * inverse_w[2]
    total = first + second + third
    # Inside the triangle the total is no less than the least q. Far outside, where no sample is
    # visible but all are evaluated, it can reach zero and the gradients would be infinite.
    floor = 0.5 * jnp.min(jax.lax.stop_gradient(inverse_w), 0)
    total = jnp.where(total < floor, floor, total)
    return safe.divide(first, total), safe.divide(second, total), safe.divide(third, total)


def mix(weights: CornerWeights, corners: Array) -> Float[Array, "channels *lanes"]:
    """Interpolate values of corners `[1 or 3, channels, lanes]` with the weights.

    A single corner is returned as it is.
    """
    if corners.shape[0] == 1:
        return corners[0]
    mixed = corners[0]
    for k in (1, 2):
        mixed = mixed + weights[k][None] * (corners[k] - corners[0])
    return mixed


def _read_lanes(
    textures: Textures,
    weights: Weights,
    corners: CornerAttributes,
    texture: Array | None,
    seen: tuple[CornerWeights, Array] | None,
    tiling: Tiling,
) -> Reading:
    @materialized
    def read(textures, weights, corners, texture, seen):
        steps = (_steps(weights, 0, tiling), _steps(weights, 1, tiling))
        return read_texture(textures, steps, corners, texture, seen)

    return read(textures, weights, corners, texture, seen)


Step = tuple[Array, Array]
"""Change of the weights of corners 1 and 2 on the screen from pixel to pixel."""


def read_texture(
    textures: Textures,
    steps: tuple[Step, Step],
    corners: CornerAttributes,
    texture: Array | None,
    seen: tuple[CornerWeights, Array] | None,
) -> Reading:
    """Choose mip levels and probes from the derivative of (u, v) by the position on the screen.

    `steps` are along x and y. `seen` has the weights of the corners and (u, v) at each point, where
    the map to the texture is not affine.
    """
    assert texture is not None
    table = textures.pyramid.levels
    base = table[:, 0].at[texture].get(mode="clip")
    x, y = (_change(step, corners, seen) for step in steps)
    tall, wide = base[..., 1].astype(x.dtype), base[..., 2].astype(x.dtype)
    chosen = probes(Footprint(x[0] * wide, x[1] * tall, y[0] * wide, y[1] * tall), textures.filter)
    texture = jnp.broadcast_to(texture, chosen.level.shape)
    levels = choose_levels(chosen.level, texture, table, textures.filter.level)
    if chosen.axis_u is None or chosen.axis_v is None:
        return Reading(levels)
    axis = jnp.stack([chosen.axis_u / wide, chosen.axis_v / tall])
    return Reading(levels, chosen.count, axis)


def _steps(weights: Weights, axis: int, tiling: Tiling) -> Step:
    """Compute the change of the weights for a step of one pixel along x (axis 0) or y (axis 1)."""
    steps = weights.edges.right if axis == 0 else weights.edges.down
    step = steps.astype(weights.per_value.dtype) * weights.per_value[None]
    if weights.plane is not None and weights.is_far is not None:
        step = jnp.where(weights.is_far[None], weights.plane[1 + axis], step)
    second, third = step * tiling.grid.rate
    return second, third


def _change(
    step: Step, corners: CornerAttributes, seen: tuple[CornerWeights, Array] | None
) -> Float[Array, "2 *lanes"]:
    """Derivative of (u, v) for a step of one pixel.

    The derivative of a quotient u = U / Q is (U' - u Q') / Q. The sums over the corners are taken
    of w_i' q_i (u_i - u), in which no large numbers cancel.
    """
    assert corners.uv is not None
    second, third = step
    first_uv, second_uv, third_uv = corners.uv
    if seen is None or corners.inverse_w is None:
        return second[None] * (second_uv - first_uv) + third[None] * (third_uv - first_uv)
    at, uv = seen
    # With affine weights a_i, w_i' = a_i q_i / Q: as they sum to one, 1 / Q = sum w_i' / q_i.
    per_total = functools.reduce(operator.add, map(safe.divide, at, corners.inverse_w))
    change = (-second - third)[None] * corners.inverse_w[0][None] * (first_uv - uv)
    change = change + second[None] * corners.inverse_w[1][None] * (second_uv - uv)
    change = change + third[None] * corners.inverse_w[2][None] * (third_uv - uv)
    return change * per_total[None]


def _probe(uv: Array, reading: Reading, probe: Array) -> tuple[Array, Array | None]:
    """Compute where a probe reads, and its weight in the mean; None is a weight of 1."""
    count, axis = reading.count, reading.axis
    if count is None or axis is None:
        return uv, None

    @materialized
    def move(uv, count, axis, probe):
        number = probe.astype(uv.dtype).reshape((1,) * count.ndim)
        is_used = number < count
        offset = jnp.where(is_used, (number + 0.5) / count - 0.5, 0.0)
        return uv + offset[None] * axis, jnp.where(is_used, 1.0 / count, 0.0)

    return move(uv, count, axis, probe)


def _tint(color: Array, texel: Array, texture: Array, share: Array | None) -> Array:
    """Multiply a premultiplied texel by a straight colour.

    Where there is no texture, the result is the premultiplied colour.
    """
    texel = jnp.where((texture < 0)[None], 1.0, texel)
    if color.shape[0] == 4 and texel.shape[0] == 3:
        texel = jnp.concatenate([texel, jnp.ones_like(texel[:1])])
    if share is not None:
        texel = texel * share[None]
    if color.shape[0] == 3:
        return jnp.concatenate([texel[:3] * color, texel[3:]])
    return jnp.concatenate([texel[:3] * color[:3], texel[3:]]) * color[3:]
