"""A translucent scene as its samples show it, and which of two layers lies in front.

A layer is a triangle that covers a sample and passes the depth test there.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..binning.tiles import TileLists
from ..coverage.depth_test import Depths
from ..geometry.fixed_point import Edges
from .sample_colors import LayerColors


class LayeredSamples(NamedTuple):
    """The layers of a translucent scene at each sample, and what its boundary term reads of them.

    - `covered`: coverage words of each listed pair.
    - `passed`: the same without the samples that fail the depth test.
    - `edges`: of all triangles; `depths`: None without a depth test.
    - `background`: RGB, or premultiplied RGBA; the image has as many channels.
    """

    covered: UInt32[Array, "pairs rows"]
    passed: UInt32[Array, "pairs rows"]
    lists: TileLists
    edges: Edges
    depths: Depths | None
    colors: LayerColors
    background: Float[Array, " channels"]


def later_is_in_front(
    other: Int[Array, "*samples"],
    triangle: Int[Array, "*#samples"],
    depth: Float[Array, "*samples"] | None,
    triangle_depth: Float[Array, "*samples"] | None,
) -> Bool[Array, "*samples"]:
    """Whether the later drawn of two layers lies in front: the triangle of an edge, or another one.

    `triangle_depth` and `depth` are the depths of these two; without them the later is in front.
    """
    if depth is None or triangle_depth is None:
        return jnp.ones(other.shape, bool)
    # Of equal depths the later is in front.
    return jnp.where(other > triangle, depth <= triangle_depth, depth >= triangle_depth)
