"""What a caller may choose: how coverage is decided and how textures are filtered. Data only."""

from typing import Literal

import equinox as eqx
import numpy as np
from jaxtyping import Array

SAMPLES = (1, 4, 9, 16, 64, 256)
"""Samples per pixel that hard mode draws: the squares of 1, 2, 3, 4, 8 and 16."""


def _one_of(name: str, value: object, allowed: tuple[object, ...]) -> None:
    if value not in allowed:
        raise ValueError(f"`{name}` must be one of {', '.join(map(repr, allowed))}; got {value!r}.")


class Hard(eqx.Module):
    """Exact supersampling: each sample is inside or outside, decided in integers.

    - `samples` per pixel, on a regular grid: 1, 4, 9, 16, 64 or 256.
    - `fill_rule`: `"inclusive"` owns every sample of the closed triangle; `"top_left"` owns a
      sample on a shared edge once, and none for triangles of zero area.
    - `shading`: where colours are evaluated: at each `"sample"` (supersampling), or once a
      `"pixel"` for each triangle there (multisampling): at the centre if the triangle holds it,
      else at the centroid of the samples of the pixel that it covers, whether they show or not.
    - `edge_gradients`: whether positions receive the derivative of the box-filtered image, which
      costs nothing until it is asked for; else they receive zero.
    """

    samples: int = eqx.field(static=True, default=16)
    fill_rule: Literal["inclusive", "top_left"] = eqx.field(static=True, default="inclusive")
    shading: Literal["sample", "pixel"] = eqx.field(static=True, default="sample")
    edge_gradients: bool = eqx.field(static=True, default=True)

    def __check_init__(self):
        _one_of("samples", self.samples, SAMPLES)
        _one_of("fill_rule", self.fill_rule, ("inclusive", "top_left"))
        _one_of("shading", self.shading, ("sample", "pixel"))

    @property
    def rate(self) -> int:
        """Samples along a side of a pixel."""
        return {1: 1, 4: 2, 9: 3, 16: 4, 64: 8, 256: 16}[self.samples]


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
    profile: Literal["logistic", "softras", "window"] = eqx.field(static=True, default="logistic")
    temperature: int | float | Array = 0.01

    def __check_init__(self):
        _one_of("profile", self.profile, ("logistic", "softras", "window"))


class Area(eqx.Module):
    """Exact area of the intersection of triangle and pixel, in closed form.

    `compositing`: `"over"` blends in draw order, and lets what lies behind show through the seams
    of triangles that abut; `"sum"` adds signed areas, which is the exact image of a tiling.
    """

    compositing: Literal["over", "sum"] = eqx.field(static=True, default="over")

    def __check_init__(self):
        _one_of("compositing", self.compositing, ("over", "sum"))


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

    pixel: Literal["nearest", "bilinear"] = eqx.field(static=True, default="bilinear")
    level: Literal["zero", "nearest", "linear"] = eqx.field(static=True, default="linear")
    anisotropy: int = eqx.field(static=True, default=1)
    lod_bias: float | Array = 0.0

    def __check_init__(self):
        _one_of("pixel", self.pixel, ("nearest", "bilinear"))
        _one_of("level", self.level, ("zero", "nearest", "linear"))
        probes = self.anisotropy
        if not isinstance(probes, int | np.integer) or not 1 <= probes <= 16:
            raise ValueError(f"`anisotropy` must be an integer in 1..16; got {probes!r}.")
