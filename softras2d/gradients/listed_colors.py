"""Colours of the triangles in the tile lists, as layers, at the samples of parts of runs.

Loops over layers read these colours in every step. Where colours are interpolated between corners,
what a step needs of each listed triangle is packed before the loop (`part_colors`).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..binning.tiles import TileLists
from ..geometry.tiling import Tiling
from ..numerics.rows import Columns, Rows
from .part_colors import colors_of_parts, pack_colors, premultiply_colors
from .run_parts import PartSamples
from .sample_colors import LayerColors


class ListedColors(NamedTuple):
    """Colours of the entries of the tile lists, each of which is a triangle in a tile.

    - `colors`: premultiplied RGBA of all triangles at any sample.
    - `triangle`: the triangle of each entry, `TileLists.triangle`.
    - `rows`, `alpha_rows`: the packed data from which RGBA and alpha are computed (`pack_colors`).
      Both are None if colours must be shaded sample by sample.
    """

    colors: LayerColors
    triangle: Int[Array, " pairs"]
    rows: Rows | None
    alpha_rows: Rows | None

    @classmethod
    def of(cls, colors: LayerColors, lists: TileLists, tiling: Tiling) -> "ListedColors":
        """Pack the colours of all entries of the tile lists, if that is possible."""
        surface = colors.interpolated
        if surface is None:
            return cls(colors, lists.triangle, None, None)
        last = jnp.maximum(surface.corners.color.shape[-1] - 1, 0)
        # Entries that are not in use have no meaning.
        lists = lists._replace(triangle=jnp.clip(lists.triangle, 0, last))
        alpha = surface.with_colors(surface.corners.color[:, 3:])
        rows, alpha_rows = (pack_colors(packed, lists, tiling) for packed in (surface, alpha))
        return cls(colors, lists.triangle, rows, alpha_rows)

    def gather(
        self, pair: Int[Array, " parts"], step: Int[Array, ""], *, alpha_only: bool
    ) -> Columns | Int[Array, " parts"]:
        """Gather what `alpha` or `color` needs of one entry for each part of a run.

        The result is to be passed to `alpha` if `alpha_only` is true, else to `color`. `step` is as
        in `on_one_core`.
        """
        rows = self.alpha_rows if alpha_only else self.rows
        if rows is None:
            return self.triangle.at[pair].get(mode="promise_in_bounds")
        return rows.gather(pair, step, repeats=1)

    def color(
        self, gathered: Columns | Int[Array, " parts"], samples: PartSamples, tiling: Tiling
    ) -> Float[Array, "4 #lines parts"]:
        """Premultiplied RGBA of each part's gathered entry at the part's samples, covered or not.

        Where each triangle has one colour, the axis of lines may have length 1.
        """
        if not isinstance(gathered, Columns):
            assert samples.sample is not None
            triangle = jnp.broadcast_to(gathered[None], samples.column.shape)
            return self.colors.at(triangle, samples.sample, tiling)
        color = colors_of_parts(gathered, samples)
        return color if self.colors.is_flat else premultiply_colors(color)

    def alpha(
        self, gathered: Columns | Int[Array, " parts"], samples: PartSamples, tiling: Tiling
    ) -> Float[Array, "#lines parts"]:
        """Alpha of each part's gathered entry at the part's samples, as the last of `color`."""
        if not isinstance(gathered, Columns):
            return self.color(gathered, samples, tiling)[3]
        return colors_of_parts(gathered, samples)[0]
