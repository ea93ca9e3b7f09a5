"""Options of a render: how coverage is decided, and how textures are filtered.

This module holds data only. Which pipeline draws an option is decided in `rendering/modes.py`.
"""

import equinox as eqx
import numpy as np
from jaxtyping import Array

from .names import (
    AreaCompositing,
    FillRule,
    LevelFilter,
    PixelFilter,
    Shading,
    SoftProfile,
    check_name,
)

SAMPLES = (1, 4, 9, 16, 64, 256)
"""Numbers of samples per pixel that hard mode draws: the squares of 1, 2, 3, 4, 8 and 16."""


class Hard(eqx.Module):
    """Exact supersampling: each sample is inside or outside, decided in integers.

    - `samples` per pixel, on a regular grid: 1, 4, 9, 16, 64 or 256.
    - `fill_rule`: under `"inclusive"` a triangle covers every sample of its closed area; under
      `"top_left"` a sample on a shared edge belongs to one of the two triangles, and triangles of
      zero area cover nothing.
    - `shading`: where colours are evaluated: at each `"sample"` (supersampling), or once a
      `"pixel"` for each triangle there (multisampling): at the centre if the triangle holds it,
      else at the centroid of the samples of the pixel that it covers, whether they show or not.
    - `edge_gradients`: whether positions receive the derivative of the box-filtered image, which
      costs nothing until it is asked for; else they receive zero.
    """

    samples: int = eqx.field(static=True, default=16)
    fill_rule: FillRule = eqx.field(static=True, default="inclusive")
    shading: Shading = eqx.field(static=True, default="sample")
    edge_gradients: bool = eqx.field(static=True, default=True)

    def __check_init__(self):
        if self.samples not in SAMPLES:
            allowed = ", ".join(map(str, SAMPLES))
            raise ValueError(f"`samples` must be one of {allowed}; got {self.samples!r}.")
        check_name("fill_rule", self.fill_rule, FillRule)
        check_name("shading", self.shading, Shading)

    @property
    def rate(self) -> int:
        """Number of samples along a side of a pixel."""
        return {1: 1, 4: 2, 9: 3, 16: 4, 64: 8, 256: 16}[self.samples]

    def describe(self) -> str:
        """One line for people."""
        return f"hard, {self.samples} samples a pixel, {self.fill_rule}, shaded by {self.shading}"


class Soft(eqx.Module):
    """Soft coverage: a smooth step of the signed distance to the triangle.

    - `width`: the distance in pixels over which coverage rises from 10 % to 90 %; 0.8 is that of a
      pixel's box filter. An array leaf of a plan: another one does not recompile (`max_width`).
    - `profile`: `"logistic"` in the distance, `"softras"` in its square (with no slope on the edge
      itself), or a `"window"`, which is a smoothstep. All are 1/2 on the edge, and 0 and 1 from a
      finite distance on: 1.38, 0.83 and 0.82 widths.
    - `temperature`: of a scene with depth, in its units: a triangle that lies deeper by as much
      has 1/e of the weight. Far below the distances in depth the nearest triangle takes all, out to
      where its coverage ends, and its outline swells; so keep it near them. An array leaf too.
    """

    width: int | float | Array = 1.0
    profile: SoftProfile = eqx.field(static=True, default="logistic")
    temperature: int | float | Array = 0.01

    def __check_init__(self):
        check_name("profile", self.profile, SoftProfile)

    @property
    def rate(self) -> int:
        """Number of sample positions along a side of a pixel: one, its centre."""
        return 1

    def describe(self) -> str:
        """One line for people."""
        width, temperature = float(self.width), float(self.temperature)
        return f"soft, {self.profile}, {width:g} px wide, temperature {temperature:g}"


class Area(eqx.Module):
    """Exact area of the intersection of triangle and pixel, in closed form.

    `compositing`: `"over"` blends in draw order, and lets what lies behind show through the seams
    of triangles that abut; `"sum"` adds signed areas, which is the exact image of a tiling.
    """

    compositing: AreaCompositing = eqx.field(static=True, default="over")

    def __check_init__(self):
        check_name("compositing", self.compositing, AreaCompositing)

    @property
    def rate(self) -> int:
        """Number of sample positions along a side of a pixel: one, its centre."""
        return 1

    def describe(self) -> str:
        """One line for people."""
        return f"exact area, composited by {self.compositing!r}"


Coverage = Hard | Soft | Area


class Filter(eqx.Module):
    """How textures are sampled.

    - `pixel`: within a mip level, the `"nearest"` texel or `"bilinear"` between four.
    - `level`: level `"zero"`, the `"nearest"` level, or `"linear"` between two.
    - `anisotropy`: probes along the longer axis of the footprint at most, 1..16; 1 is isotropic,
      which blurs a stretched texture.
    - `lod_bias`: added to the level of detail, which is that of a whole pixel; with S samples along
      its side, -log2 S leaves the blur to the samples. An array leaf of a plan: another one does
      not recompile.
    """

    pixel: PixelFilter = eqx.field(static=True, default="bilinear")
    level: LevelFilter = eqx.field(static=True, default="linear")
    anisotropy: int = eqx.field(static=True, default=1)
    lod_bias: float | Array = 0.0

    def __check_init__(self):
        check_name("pixel", self.pixel, PixelFilter)
        check_name("level", self.level, LevelFilter)
        probes = self.anisotropy
        if not isinstance(probes, int | np.integer) or not 1 <= probes <= 16:
            raise ValueError(f"`anisotropy` must be an integer in 1..16; got {probes!r}.")
