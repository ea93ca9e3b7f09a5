"""Colours of layers at the samples of runs, from data that are gathered once per run and tile.

A run is a group of successive crossings of one edge (`runs.Runs`). Its samples on one side of
the edge lie in at most two tiles (`run_tiles`).
"""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..color import premultiply
from ..geometry.barycentric import AffineWeights, interpolate_corners, weights_at
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..shading.corner_attributes import perspective_weights
from ..shading.surface import Surface, gather_lanes
from .crossings import Sample
from .run_tiles import RunTiles

SampleWeights = tuple[Float[Array, "lines runs"], Float[Array, "lines runs"]]
"""Weights of corners 1 and 2 at samples."""


def colors_of_runs(
    surface: Surface,
    triangle: Int[Array, "2 runs"],
    tiles: RunTiles,
    sample: Sample,
    tiling: Tiling,
) -> Float[Array, "channels lines runs"]:
    """Compute the colour of a triangle at each sample of each run: one triangle per tile of a run.

    The triangle need not cover the sample. Colours are returned as `surface.corners` has them if
    `surface.is_flat`; else they are premultiplied. The surface must not have textures.

    - `triangle`: the triangle for the samples in the first and in the second tile of each run.
    - `sample`: the samples, in `tiles`.
    """
    if surface.is_flat:
        return materialized(_flat_colors_of_runs)(surface.corners.color[0], triangle, tiles)
    both_tiles = triangle.reshape(-1), tiles.tile.reshape(-1)
    terms = materialized(functools.partial(Surface.weight_terms, tiling=tiling))(
        surface, *both_tiles
    )
    corners = gather_lanes(surface.corners, both_tiles[0])
    weights = materialized(functools.partial(_weights_of_runs, tiling=tiling))(
        terms, corners.inverse_w, sample, tiles
    )
    return _premultiply(materialized(_interpolate_runs)(corners.color, weights, tiles))


def _flat_colors_of_runs(
    color: Float[Array, "channels triangles"], triangle: Int[Array, "2 runs"], tiles: RunTiles
) -> Float[Array, "channels lines runs"]:
    """Gather the one colour of each triangle; arguments are as in `colors_of_runs`."""
    return tiles.of_samples(color[:, triangle])


def _weights_of_runs(
    terms: AffineWeights,
    inverse_w: Float[Array, "3 lanes"] | None,
    sample: Sample,
    tiles: RunTiles,
    *,
    tiling: Tiling,
) -> SampleWeights:
    """Compute the barycentric weights of corners 1 and 2 at the samples of runs.

    They are the weights on the triangle in space if there is an `inverse_w`, else those on the
    screen.

    - `terms`, `inverse_w`: numbers from which weights are computed (`AffineWeights`), and 1/w of
      the corners. They have a lane for the first tile of each run, then one for the second tile of
      each run. `inverse_w` is None for scenes without it.
    - `sample`: column and row of the samples on the canvas.
    """
    column, row = sample
    column, row = column % tiling.sample_columns, row % tiling.sample_rows
    runs = row.shape[1]
    in_tiles = []
    for lanes in (slice(0, runs), slice(runs, None)):
        # With an axis for the lines of a run.
        lane_terms, lane_w = jax.tree.map(
            lambda entry, lanes=lanes: entry[..., None, lanes], (terms, inverse_w)
        )
        second, third = weights_at(lane_terms, column, row)
        in_tiles.append(perspective_weights((1.0 - second - third, second, third), lane_w)[1:])
    (second, third), (second_beyond, third_beyond) = in_tiles
    is_second = tiles.is_second
    return jnp.where(is_second, second_beyond, second), jnp.where(is_second, third_beyond, third)


def _interpolate_runs(
    color: Float[Array, "3 channels lanes"], weights: SampleWeights, tiles: RunTiles
) -> Float[Array, "channels lines runs"]:
    """Interpolate the colours of the corners at the samples of runs, without premultiplying them.

    `weights` are the barycentric weights of corners 1 and 2 at the samples. Lanes of `color` are
    the first tiles of all runs, then the second tiles of all runs.
    """
    runs = color.shape[-1] // 2
    corners = tiles.of_samples(color.reshape(*color.shape[:2], 2, runs))
    return interpolate_corners(corners, weights[0][None], weights[1][None])


@materialized
def _premultiply(color: Float[Array, "channels lines runs"]) -> Float[Array, "channels lines runs"]:
    """Multiply RGB by alpha; colours without alpha stay unchanged."""
    return premultiply(color, axis=0)
