"""A translucent scene as its samples show it, and the colours of its layers.

A layer is a triangle that covers a sample and passes the depth test there. Colours here are always
premultiplied RGBA, whatever the scene's are.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..binning.tiles import TileLists
from ..coverage.depth_test import Depths
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..shading.surface import Surface
from .crossings import Sample
from .visible_front import color_at, color_on_edge


class LayeredSamples(NamedTuple):
    """A translucent scene as its samples show it: inputs of its boundary term.

    - `covered`: coverage words of each listed pair.
    - `passed`: the same without the samples that fail the depth test.
    - `depths`: None without a depth test.
    """

    covered: UInt32[Array, "pairs rows"]
    passed: UInt32[Array, "pairs rows"]
    lists: TileLists
    surface: Surface
    depths: Depths | None
    background: Float[Array, " channels"]


def later_is_in_front(
    other: Int[Array, "*samples"],
    triangle: Int[Array, "*samples"],
    depth: Float[Array, "*samples"] | None,
    triangle_depth: Float[Array, "*samples"] | None,
) -> Bool[Array, "*samples"]:
    """Whether, of each triangle and another layer, the one that is drawn later lies in front.

    `depth` is that of the other layer.
    """
    if depth is None or triangle_depth is None:
        return jnp.ones(other.shape, bool)
    # Of equal depths the later is in front.
    return jnp.where(other > triangle, depth <= triangle_depth, depth >= triangle_depth)


def rgba_on_edge(
    surface: Surface,
    edge: Int[Array, " runs"],
    t: Float[Array, "lines runs"],
    tiling: Tiling,
    *,
    flat: bool,
) -> Float[Array, "4 lines runs"]:
    """Premultiplied RGBA of each edge's triangle on the edge, the fraction `t` (0..1) along it."""
    color = color_on_edge(surface, edge, t, tiling, flat=flat)
    return materialized(functools.partial(_to_rgba, flat=flat))(color)


def rgba_at(
    surface: Surface,
    triangle: Int[Array, "lines runs"],
    sample: Sample,
    tiling: Tiling,
    *,
    flat: bool,
) -> Float[Array, "4 lines runs"]:
    """Premultiplied RGBA of a triangle at a sample."""
    clear = jnp.zeros(surface.channels, surface.corners.color.dtype)
    color = color_at(surface, clear, triangle, sample, tiling, flat=flat)
    return materialized(functools.partial(_to_rgba, flat=flat))(color)


def rgba_at_each(
    surface: Surface, triangle: Int[Array, " group"], sample: Sample, tiling: Tiling
) -> Float[Array, "4 group"]:
    """Premultiplied RGBA of triangles at samples, for a list of both."""
    at = Sample(sample.column[None], sample.row[None])
    return rgba_at(surface, triangle[None], at, tiling, flat=surface.is_flat)[:, 0]


def _to_rgba(
    color: Float[Array, "channels lines runs"], *, flat: bool
) -> Float[Array, "4 lines runs"]:
    """Add the alpha of opaque colours; premultiply those of flat triangles, which are straight."""
    if color.shape[0] == 3:
        return jnp.concatenate([color, jnp.ones_like(color[:1])])
    if flat:
        return jnp.concatenate([color[:3] * color[3:], color[3:]])
    return color
