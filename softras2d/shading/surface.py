"""Data of the triangles that shading needs, for all triangles or gathered for some.

A `Surface` holds the data of all triangles. A *lane* is one item to be shaded: a triangle in a
tile, or in a pixel of a tile. `Lanes` holds the data of one triangle for each lane.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..geometry.barycentric import (
    AffineWeights,
    Weights,
    affine_weights,
    slot_weights,
    twice_area,
)
from ..geometry.fixed_point import Edges
from ..geometry.guard_band import WeightPlanes
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..options import Filter
from ..texture.pyramid import TexturePyramid
from .corner_attributes import CornerAttributes, CornerWeights
from .texture_lookup import (
    LevelsAndProbes,
    PerspectivePoint,
    PixelStep,
    Textures,
    choose_levels_and_probes,
)

Tree = TypeVar("Tree")
"""A tree of arrays."""


class Points(NamedTuple):
    """Points in tiles, each of them the mean position of some samples of its tile.

    - `count`: number of the samples; None for a single sample.
    - `across`, `down`: sums of the samples' columns and of their rows, counted from the tile's
      first sample.

    Samples, centres of pixels and centroids are thus all given by exact integers.
    """

    count: Int[Array, "*points"] | None
    across: Int[Array, "*points"]
    down: Int[Array, "*points"]


class Surface(NamedTuple):
    """All data of the triangles that shading needs, for all triangles of a scene.

    - `edges`: exact edge functions.
    - `area`: twice the area of each triangle, from `barycentric.twice_area`, in units of 2^-bits /
      rate square pixels with the fields of `Grid`.
    - `planes`: barycentric weights of triangles past the guard band; None if there can be none.
    - `corners`: colours, texture coordinates and `inverse_w` at the corners.
    - `texture`: index of each triangle's texture, -1 for none; None for a scene without textures.
    - `textures`: all textures; None for a scene without any.
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

    @property
    def probes(self) -> int:
        """Greatest number of texture probes at each point; 1 for a surface without textures.

        A probe is one of several reads of a texture, whose mean is taken.
        """
        return 1 if self.textures is None else self.filter.anisotropy

    def with_colors(self, colors: Float[Array, "corners channels triangles"]) -> "Surface":
        """Return the surface with `colors` as the colours of the corners."""
        return self._replace(corners=self.corners._replace(color=colors))

    @property
    def is_flat(self) -> bool:
        """Whether each triangle has one colour: there are no textures and no corner colours."""
        return self.textures is None and self.corners.color.shape[0] == 1

    def weight_terms(
        self, triangle: Int[Array, " lanes"], tile: Int[Array, " lanes"], tiling: Tiling
    ) -> AffineWeights:
        """Compute the numbers from which the barycentric weights of lanes are evaluated.

        Lane k is triangle `triangle[k]` in tile `tile[k]`. `barycentric.weights_at` evaluates the
        weights of corners 1 and 2 at single samples of that tile; the weight of corner 0 is 1 minus
        the other two.
        """
        weights = slot_weights(self.edges, self.area, triangle, tile, tiling, self.planes)
        return affine_weights(weights)


class Lanes(NamedTuple):
    """The data of a surface gathered for lanes; the last axis of every entry is `lanes`.

    A lane is one item to be shaded: a triangle in a tile, or in a pixel of a tile.

    - `weights`: terms of the barycentric weights of the lane's triangle in its tile.
    - `corners`, `texture`: as in `Surface`, for the triangle of each lane.
    - `levels_and_probes`: mip levels and probes of the texture lookup, if they are the same at all
      points of a lane. None in perspective, and for a scene without textures.
    """

    weights: Weights
    corners: CornerAttributes
    texture: Int[Array, " lanes"] | None
    levels_and_probes: LevelsAndProbes | None


def surface_of(
    edges: Edges,
    planes: WeightPlanes | None,
    corners: CornerAttributes,
    texture: Int[Array, " triangles"] | None,
    pyramid: TexturePyramid | None,
    filter: Filter,
) -> Surface:
    """Collect the data of the triangles that shading needs, as a `Surface`.

    `pyramid` has the textures of the scene, None for a scene without any.
    """
    area = materialized(functools.partial(twice_area, dtype=corners.color.dtype))(edges)
    return Surface(edges, area, planes, corners, texture, Textures.of(pyramid, filter), filter)


def count_channels(corners: CornerAttributes, textures: Textures | None) -> int:
    """Number of channels of shaded colours: four if colours or texels have alpha, else three."""
    return max(corners.color.shape[1], 3 if textures is None else textures.channels)


@materialized
def gather_lanes(tree: Tree, lane: Int[Array, " gathered"]) -> Tree:
    """Gather the lanes with the indices `lane` from a tree of arrays `[..., lanes]`.

    A lane may be gathered several times.
    """

    def gather_entry(entry: Array) -> Array:
        # The gather is along a single flat axis: XLA stores the result of a gather along one of
        # two axes transposed.
        rows, lanes = entry.size // entry.shape[-1], entry.shape[-1]
        index = jnp.arange(rows, dtype=jnp.int32)[:, None] * lanes + lane[None]
        gathered = entry.reshape(-1).at[index].get(mode="promise_in_bounds")
        return gathered.reshape(*entry.shape[:-1], -1)

    return jax.tree.map(gather_entry, tree)


def surface_lanes(
    surface: Surface, triangle: Int[Array, " lanes"], tile: Int[Array, " lanes"], tiling: Tiling
) -> Lanes:
    """Gather the data of a surface for lanes, each of which is a triangle in a tile.

    Lane k is triangle `triangle[k]` in tile `tile[k]`.
    """
    weights = _lane_weights(surface, triangle, tile, tiling)
    corners, texture = gather_lanes((surface.corners, surface.texture), triangle)
    chosen = None
    if surface.textures is not None and corners.inverse_w is None:
        # An affine map has one footprint for all points of a triangle.
        chosen = _choose_on_lanes(surface.textures, weights, corners, texture, None, tiling)
    return Lanes(weights, corners, texture, chosen)


@functools.partial(materialized, static_argnames=("tiling",))
def _lane_weights(
    surface: Surface, triangle: Int[Array, " lanes"], tile: Int[Array, " lanes"], tiling: Tiling
) -> Weights:
    """Gather the `barycentric.Weights` of lanes, each of which is a triangle in a tile."""
    return slot_weights(surface.edges, surface.area, triangle, tile, tiling, surface.planes)


def level_chooser(
    surface: Surface, lanes: Lanes, weights: CornerWeights, tiling: Tiling
) -> Callable[[Array], LevelsAndProbes | None]:
    """Make the function from (u, v) at points to the mip levels and probes of the lookup there.

    `weights` are the barycentric weights at the points, on the triangle in space. Without
    perspective the answer is the same for all points of a lane, and (u, v) is not read. The
    function returns None for a surface without textures.
    """

    def choose(uv: Array) -> LevelsAndProbes | None:
        if lanes.levels_and_probes is not None or surface.textures is None:
            return lanes.levels_and_probes
        return _choose_on_lanes(
            surface.textures, lanes.weights, lanes.corners, lanes.texture, (weights, uv), tiling
        )

    return choose


@functools.partial(materialized, static_argnames=("tiling",))
def _choose_on_lanes(
    textures: Textures,
    weights: Weights,
    corners: CornerAttributes,
    texture: Int[Array, " lanes"] | None,
    point: PerspectivePoint | None,
    tiling: Tiling,
) -> LevelsAndProbes:
    """Choose mip levels and probes for each lane, and in perspective for one point of each lane.

    - `weights`: terms of the barycentric weights of each lane (`barycentric.Weights`).
    - `point`: the point of each lane in perspective; None otherwise.
    """
    steps = (pixel_step(weights, 0, tiling), pixel_step(weights, 1, tiling))
    return choose_levels_and_probes(textures, steps, corners, texture, point)


def pixel_step(weights: Weights, axis: int, tiling: Tiling) -> PixelStep:
    """Compute the change of two weights for a step of one pixel along x (axis 0) or y (axis 1).

    They are the barycentric weights of corners 1 and 2 on the screen. `weights` has the terms from
    which they are computed. Returns the change of corner 1's weight, then that of corner 2's.
    """
    sample_step = weights.edges.right if axis == 0 else weights.edges.down
    step = sample_step.astype(weights.per_value.dtype) * weights.per_value[None]
    if weights.plane is not None and weights.is_far is not None:
        step = jnp.where(weights.is_far[None], weights.plane[1 + axis], step)
    second, third = step * tiling.grid.rate
    return second, third
