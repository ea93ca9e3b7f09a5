"""Colours of layers at the samples of runs, from data that are packed once per listed triangle.

A run is a group of successive crossings of one edge (`runs.Runs`). Its samples on one side of
the edge lie in at most two tiles (`run_tiles`). A loop over layers gathers the data of two listed
triangles for each run, one for each of its tiles, and computes a colour for each sample.
"""

import functools

import jax
from jaxtyping import Array, Float

from ..binning.tiles import TileLists
from ..color import premultiply
from ..geometry.barycentric import AffineWeights, interpolate_corners, weights_at
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..numerics.rows import Columns, Rows, pack_rows
from ..shading.corner_attributes import perspective_weights
from ..shading.surface import Surface, gather_lanes
from .run_tiles import RunTiles

SampleWeights = tuple[Float[Array, "lines runs"], Float[Array, "lines runs"]]
"""Barycentric weights of corners 1 and 2 of a triangle, at each sample of each run."""


def pack_colors(surface: Surface, lists: TileLists, tiling: Tiling) -> Rows:
    """Pack what colours at samples need of each entry of the tile lists, a triangle in a tile.

    It is the colour of each corner of the triangle. Unless triangles have one colour, it is also
    the terms of the barycentric weights in the tile (`AffineWeights`), and 1/w of the corners
    (None without perspective). The surface must not have textures.
    """
    terms = None
    if not surface.is_flat:
        weight_terms = materialized(functools.partial(Surface.weight_terms, tiling=tiling))
        terms = weight_terms(surface, lists.triangle, lists.tile)
    corners = gather_lanes(surface.corners, lists.triangle)
    return pack_rows((corners.color, terms, corners.inverse_w))


def colors_of_runs(columns: Columns, tiles: RunTiles) -> Float[Array, "channels lines runs"]:
    """Compute the colour of a triangle at each sample of each run: one triangle per tile of a run.

    The triangle need not cover the sample. Colours have straight alpha if the packed colours have,
    and each triangle with one colour has that colour. `columns` has the packed data of the
    triangles in the first tiles of all runs, then of those in their second tiles.
    """
    color, terms, _ = columns.unpack()
    if terms is None:
        return tiles.of_samples(_by_tile(color[0]))
    # In two calls, because one core does the work of calls that are short enough (`one_core`).
    weights = materialized(_weights_of_runs)(columns, tiles)
    return materialized(_interpolate_runs)(columns, weights, tiles)


@materialized
def premultiply_runs(
    color: Float[Array, "channels lines runs"],
) -> Float[Array, "channels lines runs"]:
    """Multiply RGB by alpha; colours without alpha stay unchanged."""
    return premultiply(color, axis=0)


def _by_tile(values: Array) -> Array:
    """Split the last axis, first tiles and then second tiles of all runs: `[..., 2, runs]`."""
    return values.reshape(*values.shape[:-1], 2, -1)


def _weights_of_runs(columns: Columns, tiles: RunTiles) -> SampleWeights:
    """Compute the barycentric weights of corners 1 and 2 at the samples of runs.

    They are the weights on the triangle in space if there is perspective, else those on the screen.
    """
    _, packed_terms, packed_w = columns.unpack()
    terms: AffineWeights = jax.tree.map(lambda x: tiles.of_samples(_by_tile(x)), packed_terms)
    second, third = weights_at(terms, tiles.column, tiles.row)
    if packed_w is None:
        return second, third
    inverse_w = tiles.of_samples(_by_tile(packed_w))
    return perspective_weights((1.0 - second - third, second, third), inverse_w)[1:]


def _interpolate_runs(
    columns: Columns, weights: SampleWeights, tiles: RunTiles
) -> Float[Array, "channels lines runs"]:
    """Interpolate the colours of the corners at the samples of runs, without premultiplying them.

    `weights` are the barycentric weights of corners 1 and 2 at the samples.
    """
    corners = tiles.of_samples(_by_tile(columns.unpack()[0]))
    return interpolate_corners(corners, weights[0][None], weights[1][None])
