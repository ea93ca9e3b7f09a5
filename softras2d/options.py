"""Options of a render: how coverage is computed, and how textures are filtered.

This module holds data only. The table in `rendering/modes.py` maps each option to its pipeline.
"""

from typing import Any

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
"""Numbers of samples per pixel that `Hard` accepts: the squares of 1, 2, 3, 4, 8 and 16."""


def _plain(value: Any) -> Any:
    """Convert a scalar of NumPy or JAX to a Python number, since static fields are not arrays.

    Other values are returned unchanged.
    """
    return value.item() if getattr(value, "ndim", None) == 0 else value


class Hard(eqx.Module):
    """Exact supersampling: integer arithmetic decides whether each sample is inside.

    - `samples`: samples per pixel: 1, 4, 9, 16, 64 or 256. They form a regular grid. With S samples
      along the side of a pixel, sample i of a row lies (i + 1/2) / S pixels from the pixel's left.
    - `fill_rule`: with `"inclusive"`, a triangle covers every sample of its closed area. With
      `"top_left"`, a sample on the edge between two adjacent triangles belongs to just one of
      them, and triangles of zero area cover nothing.
    - `shading`: with `"sample"`, colours are evaluated at each sample (supersampling). With
      `"pixel"`, they are evaluated once per pixel and triangle (multisampling): at the pixel centre
      if the triangle covers it, else at the centroid of all samples of the pixel that the triangle
      covers, visible or not.
    - `edge_gradients`: whether positions receive the derivative of the box-filtered image, which
      costs nothing unless a derivative is taken. If false, their gradient is zero. An edge adds
      nothing where layers in front of it have a transmittance below eps^2, the square of the
      distance from 1 to the next larger float: 1.4e-14 in float32.
    """

    samples: int = eqx.field(static=True, converter=_plain, default=16)
    fill_rule: FillRule = eqx.field(static=True, default="inclusive")
    shading: Shading = eqx.field(static=True, default="sample")
    edge_gradients: bool = eqx.field(static=True, converter=_plain, default=True)

    def __check_init__(self):
        if self.samples not in SAMPLES:
            allowed = ", ".join(map(str, SAMPLES))
            raise ValueError(f"`samples` must be one of {allowed}; got {self.samples!r}.")
        check_name("fill_rule", self.fill_rule, FillRule)
        check_name("shading", self.shading, Shading)

    @property
    def rate(self) -> int:
        """Number of samples along a side of a pixel, the square root of `samples`."""
        return {1: 1, 4: 2, 9: 3, 16: 4, 64: 8, 256: 16}[self.samples]

    def describe(self) -> str:
        """Describe the option in one line of text."""
        return f"hard, {self.samples} samples per pixel, {self.fill_rule}, shaded by {self.shading}"


class Soft(eqx.Module):
    """Soft coverage: a smooth step of the signed distance to the triangle.

    - `width`: the distance in pixels, above 0, over which coverage rises from 10 % to 90 %; a
      number or a scalar array. For comparison, a box filter of one pixel has a width of 0.8. The
      width is an array leaf of a plan, so a new value does not recompile, but it may not exceed the
      width and the `max_width` for which the plan was made, whichever is larger.
    - `profile`: `"logistic"`, a logistic function of the signed distance; `"softras"`, a logistic
      function of its square with the same sign, with derivative 0 on the edge itself; or
      `"window"`, a smoothstep. All three are 1/2 on the edge. They are 0 outside and 1 inside from
      a finite distance on: 1.38, 0.83 and 0.82 widths.
    - `temperature`: a difference in depth, above 0, in the unit of `Scene.depth`. It decides how
      much nearer triangles outweigh deeper ones in scenes with depth: a triangle that is deeper by
      the temperature has 1/e of the weight. Keep it near the differences in depth of the scene. If
      it is far below them, the nearest triangle hides all others as far as its coverage reaches, so
      that its outline swells. The temperature is an array leaf of a plan, like the width.
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
        """Describe the option in one line of text."""
        width, temperature = float(self.width), float(self.temperature)
        return f"soft, {self.profile}, {width:g} px wide, temperature {temperature:g}"


class Area(eqx.Module):
    """Exact area of the intersection of triangle and pixel, in closed form.

    Scenes with depth are refused, as there is no depth test.

    - `compositing`: `"over"` blends triangles in draw order; the background then shows faintly at
      the seams of adjacent triangles. `"sum"` adds premultiplied colours times signed areas, which
      gives the exact image of triangles that cover the plane without gap or overlap. A triangle
      is subtracted if its sign is not that of the sum of the signed areas of all triangles.
    """

    compositing: AreaCompositing = eqx.field(static=True, default="over")

    def __check_init__(self):
        check_name("compositing", self.compositing, AreaCompositing)

    @property
    def rate(self) -> int:
        """Number of sample positions along a side of a pixel: one, its centre."""
        return 1

    def describe(self) -> str:
        """Describe the option in one line of text."""
        return f"exact area, composited by {self.compositing!r}"


Coverage = Hard | Soft | Area


class Filter(eqx.Module):
    """How textures are sampled.

    - `pixel`: within a mip level, the `"nearest"` texel or `"bilinear"` between four.
    - `level`: mip level `"zero"` (the full image) alone, the `"nearest"` level to the level of
      detail, or a `"linear"` blend of the two levels next to it.
    - `anisotropy`: maximum number of probes along the longer axis of the footprint, 1..16. 1 is
      isotropic, which blurs a stretched texture.
    - `lod_bias`: number of levels that is added to the level of detail. By default the level of
      detail is that of the footprint of a pixel. With S samples along the side of a pixel, a bias
      of -log2 S chooses the level for the footprint of one sample, which gives a sharper image, as
      the samples of the pixel are averaged anyway. The bias is an array leaf of a plan, so a new
      value does not recompile.
    """

    pixel: PixelFilter = eqx.field(static=True, default="bilinear")
    level: LevelFilter = eqx.field(static=True, default="linear")
    anisotropy: int = eqx.field(static=True, converter=_plain, default=1)
    lod_bias: float | Array = 0.0

    def __check_init__(self):
        check_name("pixel", self.pixel, PixelFilter)
        check_name("level", self.level, LevelFilter)
        probes = self.anisotropy
        if not isinstance(probes, int | np.integer) or not 1 <= probes <= 16:
            raise ValueError(f"`anisotropy` must be an integer in 1..16; got {probes!r}.")
