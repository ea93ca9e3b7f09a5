"""Colours of the triangles in the tile lists, as layers, at the samples of runs.

Loops over layers read these colours in every step. Where colours are interpolated between corners,
what a step needs of each listed triangle is packed before the loop (`run_colors`).
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..binning.tiles import TileLists
from ..geometry.tiling import Tiling
from ..numerics.rows import Columns, Rows
from .crossings import Sample
from .run_colors import colors_of_runs, pack_colors, premultiply_runs
from .run_tiles import RunTiles
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
        self, pair: Int[Array, "2 runs"], step: Int[Array, ""], *, alpha_only: bool
    ) -> Columns | Int[Array, "2 runs"]:
        """Gather what `alpha` or `color` needs of one entry for each of the two tiles of a run.

        The result is to be passed to `alpha` if `alpha_only` is true, else to `color`. `step` is as
        in `on_one_core`.
        """
        rows = self.alpha_rows if alpha_only else self.rows
        if rows is None:
            return self.triangle.at[pair].get(mode="promise_in_bounds")
        return rows.gather(pair.reshape(-1), step, repeats=1)

    def color(
        self,
        gathered: Columns | Int[Array, "2 runs"],
        tiles: RunTiles,
        sample: Sample,
        tiling: Tiling,
    ) -> Float[Array, "4 lines runs"]:
        """Premultiplied RGBA of the gathered entries at each sample, covered or not.

        The entry is that of the tile in which the sample lies. `tiles` are the tiles of `sample`.
        """
        if not isinstance(gathered, Columns):
            return self.colors.at(tiles.of_samples(gathered), sample, tiling)
        color = colors_of_runs(gathered, tiles)
        if not self.colors.is_flat:
            color = premultiply_runs(color)
        return color

    def alpha(
        self,
        gathered: Columns | Int[Array, "2 runs"],
        tiles: RunTiles,
        sample: Sample,
        tiling: Tiling,
    ) -> Float[Array, "lines runs"]:
        """Alpha of the gathered entries at each sample, as the last channel of `color`."""
        if not isinstance(gathered, Columns):
            return self.color(gathered, tiles, sample, tiling)[3]
        return colors_of_runs(gathered, tiles)[0]
