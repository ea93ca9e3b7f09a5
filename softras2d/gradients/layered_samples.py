"""The samples of a translucent scene and their layers, and which of two layers lies in front.

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
    """The layers of a translucent scene at each sample, as the boundary term needs them.

    - `covered`: coverage words of each entry of `lists`, a pair of a triangle and a tile.
    - `passed`: the same without the samples that fail the depth test.
    - `lists`: the tile lists.
    - `edges`: edge functions of all triangles.
    - `depths`: inputs of the depth test; None without one.
    - `colors`: colours of the triangles at samples and on edges.
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
    """Whether, of the layers `other` and `triangle`, the one that is drawn later lies in front.

    Both are indices of triangles, which are also their draw order. `depth` is the depth of `other`,
    and `triangle_depth` the depth of `triangle`. The result is true at equal depths, and also if
    either depth is None, in scenes without depth.
    """
    if depth is None or triangle_depth is None:
        return jnp.ones(other.shape, bool)
    # At equal depths the triangle that is drawn later is in front.
    return jnp.where(other > triangle, depth <= triangle_depth, depth >= triangle_depth)
