"""Colours of layers at the samples of parts of runs, from packed data of the listed triangles.

A run is a group of successive crossings of one edge (`runs.Runs`). The samples of a part of a run
lie in one tile (`run_parts`). A loop over layers gathers the data of one listed triangle for each
part, and computes a colour for each sample.
"""

import functools

import jax
from jaxtyping import Array, Float

from ..binning.tiles import TileLists
from ..color import premultiply
from ..geometry.barycentric import interpolate_corners, weights_at
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..numerics.rows import Columns, Rows, pack_rows
from ..shading.corner_attributes import perspective_weights
from ..shading.surface import Surface, gather_lanes
from .run_parts import PartSamples

SampleWeights = tuple[Float[Array, "lines parts"], Float[Array, "lines parts"]]
"""Barycentric weights of corners 1 and 2 of a triangle, at each sample of each part of a run."""


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


def colors_of_parts(
    columns: Columns, samples: PartSamples
) -> Float[Array, "channels #lines parts"]:
    """Compute the colour of one triangle for each part of a run, at each sample of the part.

    The triangle need not cover the sample. Colours have straight alpha if the packed colours have.
    Triangles of one colour have this colour, and the axis of lines has length 1. `columns` has the
    packed data of the triangles.
    """
    color, terms, _ = columns.unpack()
    if terms is None:
        return color[0][:, None]
    # In two calls, because one core does the work of calls that are short enough (`one_core`).
    weights = materialized(_weights_of_parts)(columns, samples)
    return materialized(_interpolate)(columns, weights)


@materialized
def premultiply_colors(
    color: Float[Array, "channels lines parts"],
) -> Float[Array, "channels lines parts"]:
    """Multiply RGB by alpha; colours without alpha stay unchanged."""
    return premultiply(color, axis=0)


def _weights_of_parts(columns: Columns, samples: PartSamples) -> SampleWeights:
    """Compute the barycentric weights of corners 1 and 2 at each sample of each part.

    They are the weights on the triangle in space if there is perspective, else those on the screen.
    """
    terms, inverse_w = jax.tree.map(lambda entry: entry[..., None, :], columns.unpack()[1:])
    second, third = weights_at(terms, samples.column, samples.row)
    return perspective_weights((1.0 - second - third, second, third), inverse_w)[1:]


def _interpolate(columns: Columns, weights: SampleWeights) -> Float[Array, "channels lines parts"]:
    """Interpolate the colours of the corners at each sample, without premultiplying them.

    `weights` are the barycentric weights of corners 1 and 2 at the samples.
    """
    corners = columns.unpack()[0][:, :, None]
    return interpolate_corners(corners, weights[0][None], weights[1][None])
