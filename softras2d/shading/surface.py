"""Triangles as shading sees them: their corner attributes, textures, and views of some of them.

A *surface* holds what all triangles need. *Lanes* are a view of it: the entries of one triangle
for each point that is shaded.
"""

from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..geometry.barycentric import Weights, twice_area
from ..geometry.fixed_point import Edges, reorient
from ..geometry.guard_band import WeightPlanes
from ..numerics.fusion_barrier import materialized
from ..options import Filter
from ..texture.level_of_detail import Levels
from ..texture.pyramid import TexturePyramid

Tree = TypeVar("Tree")

CornerWeights = tuple[Array, Array, Array]
"""One value per corner."""


class Points(NamedTuple):
    """Points in tiles, as sums of the columns and rows of `count` samples; None is one sample.

    Samples, centres of pixels and centroids are thus all exact integers.
    """

    count: Int[Array, "*points"] | None
    across: Int[Array, "*points"]
    down: Int[Array, "*points"]


class CornerAttributes(NamedTuple):
    """Vertex attributes at the corners of triangles, reoriented to positive orientation.

    They are `[corners, channels, triangles]`, and `[3, triangles]` for `inverse_w`. None means that
    the scene does not have the attribute.
    """

    color: Float[Array, "corners channels *lanes"]
    inverse_w: Float[Array, "3 *lanes"] | None = None
    uv: Float[Array, "3 2 *lanes"] | None = None


def at_corners(
    values: Float[Array, " vertices"],
    triangles: Int[Array, "triangles 3"],
    orientation: Int[Array, " triangles"],
) -> Float[Array, "3 triangles"]:
    """Gather vertex values at the corners of triangles in positive orientation."""
    return reorient(values[triangles].T, orientation)


def corner_attributes(
    colors: Float[Array, "triangles corners channels"],
    uv: Float[Array, "triangles 3 2"] | None,
    inverse_w: Float[Array, " vertices"] | None,
    triangles: Int[Array, "triangles 3"],
    orientation: Int[Array, " triangles"],
) -> CornerAttributes:
    """Attributes at the corners of triangles in positive orientation; triangles come last."""

    def reorient_each(values: Array) -> Array:
        return jax.vmap(reorient, (1, None), 1)(values.transpose(1, 2, 0), orientation)

    colors = reorient_each(colors) if colors.shape[1] == 3 else colors.transpose(1, 2, 0)
    uv = None if uv is None else reorient_each(uv)
    if inverse_w is not None:
        inverse_w = at_corners(inverse_w, triangles, orientation)
    return CornerAttributes(colors, inverse_w, uv)


class Textures(NamedTuple):
    """Textures and how they are sampled; `texels` is `[channels, texels]`."""

    pyramid: TexturePyramid
    texels: Float[Array, "channels texels"]
    filter: Filter

    @classmethod
    def of(cls, pyramid: TexturePyramid | None, filter: Filter) -> "Textures | None":
        """Make the textures of a pyramid, or None without textures."""
        if pyramid is None:
            return None
        return cls(pyramid, materialized(jnp.transpose)(pyramid.texels), filter)


class Surface(NamedTuple):
    """All data of the triangles that shading needs.

    - `area`: twice the area of each triangle, in units of the edge value.
    - `texture`: index of each triangle's texture, -1 for none; `textures`: the textures.
    - `filter`: how textures are sampled.
    """

    edges: Edges
    area: Float[Array, " triangles"]
    planes: WeightPlanes | None
    corners: CornerAttributes
    texture: Int[Array, " triangles"] | None
    textures: Textures | None
    filter: Filter

    @property
    def channels(self) -> int:
        """Number of colour channels: four if any colour or texel can be translucent, else three."""
        return count_channels(self.corners, self.textures)


class Reading(NamedTuple):
    """Mip levels from which a texture is sampled, and `count` probes along an axis.

    The axis is a vector (u, v), where 1 is the extent of the image. `count` and `axis` are None for
    a single probe.
    """

    levels: Levels
    count: Float[Array, "*points"] | None = None
    axis: Float[Array, "2 *points"] | None = None


class Lanes(NamedTuple):
    """The attributes of a surface gathered per lane: every entry is `[..., lanes]`.

    `reading` is None where it differs from point to point, or where there is no texture.
    """

    weights: Weights
    corners: CornerAttributes
    texture: Int[Array, " lanes"] | None
    reading: Reading | None


def surface_of(
    edges: Edges,
    planes: WeightPlanes | None,
    corners: CornerAttributes,
    texture: Array | None,
    pyramid: TexturePyramid | None,
    filter: Filter,
) -> Surface:
    """Collect the data of the triangles that shading needs."""
    area = materialized(lambda edges: twice_area(edges, corners.color.dtype))(edges)
    return Surface(edges, area, planes, corners, texture, Textures.of(pyramid, filter), filter)


def count_channels(corners: CornerAttributes, textures: Textures | None) -> int:
    """Number of channels of the shaded colours."""
    return max(corners.color.shape[1], 3 if textures is None else textures.texels.shape[0])


def gather_lanes(held: Tree, lane: Int[Array, " lanes"]) -> Tree:
    """Gather entries `[..., lanes]` of some lanes; a lane may occur several times."""

    @materialized
    def gather(tree, lane):
        def gather_entry(entry):
            # The gather is along a single flat axis: XLA stores the result of a gather along one of
            # two axes transposed.
            rows, lanes = entry.size // entry.shape[-1], entry.shape[-1]
            index = jnp.arange(rows, dtype=jnp.int32)[:, None] * lanes + lane[None]
            gathered = entry.reshape(-1).at[index].get(mode="promise_in_bounds")
            return gathered.reshape(*entry.shape[:-1], -1)

        return jax.tree.map(gather_entry, tree)

    return gather(held, lane)
