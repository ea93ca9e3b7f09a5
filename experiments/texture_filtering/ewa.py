"""The elliptical weighted average (EWA): a Gaussian mean of the texels in a pixel's footprint.

A disc of `radius` pixels around the centre of a pixel becomes an ellipse on the texture. The
ellipse is read from the mip level on which its shorter axis is at least `least` texels long, and
less than twice as long. Weights fall to exp(-2) at the border of the ellipse. On the base level,
the ellipse is at least two texels across, so that it always contains a texel; the last level is one
texel.

**Source:** Heckbert, *Fundamentals of Texture Mapping and Image Warping* (1989), section 3.5;
Greene and Heckbert, *Creating Raster Omnimax Images from Multiple Perspective Views Using the
Elliptical Weighted Average Filter* (IEEE CG&A 6(6), 1986), for the scan through the ellipse's box.
"""

# Experiments need numba, which the type checker's environment does not have.
# pyright: reportMissingImports=false

import math
from typing import NamedTuple

import numba as nb
import numpy as np

import softras2d as sr

from .footprints import Footprints


class Ewa(NamedTuple):
    """Parameters of the filter.

    - `radius`: radius of the disc, in pixels; Heckbert's is 1.
    - `least`: least length of the shorter axis, in texels.
    - `ratio`: greatest ratio of the axes. Longer ellipses are widened to it, which blurs.
    """

    radius: float
    least: float
    ratio: float = 16.0

    @property
    def name(self) -> str:
        return f"EWA, radius {self.radius:g} px, {self.least:g} texels across"


def filtered(scene: sr.Scene, at: Footprints, choice: Ewa) -> tuple[np.ndarray, ...]:
    """Colours `[pixels, 3]` of interior pixels, and numbers of texels read and texels in the box.

    Each texel of the box around the ellipse is tested; texels within the ellipse are read.
    """
    assert scene.textures is not None
    pyramid = scene.textures
    return _filter(
        np.asarray(pyramid.texels, np.float64),
        np.asarray(pyramid.levels, np.int64),
        at.texture[at.interior],
        at.uv[at.interior],
        at.jacobian[at.interior],
        pyramid.border == "repeat",
        choice.radius,
        choice.least,
        choice.ratio,
    )


@nb.njit(cache=True)
def _filter(texels, levels, textures, uvs, jacobians, repeat, radius, least, ratio):
    count = uvs.shape[0]
    colors = np.zeros((count, 3))
    reads, tests = np.zeros(count, np.int64), np.zeros(count, np.int64)
    for i in range(count):
        table = levels[textures[i]]
        xx, xy, yy, shorter = _ellipse(jacobians[i], radius, ratio)
        level = math.floor(math.log2(2 * shorter / least)) if 2 * shorter > least else 0
        offset, height, width = table[min(level, table.shape[0] - 1)]
        if height * width == 1:
            colors[i] = texels[offset]
            reads[i] = tests[i] = 1
            continue
        # Converts texels of the base level to texels of this level.
        scale = (width / table[0, 2]) ** 2
        xx, xy, yy = _widen(xx * scale, xy * scale, yy * scale, 1.0)
        determinant = xx * yy - xy * xy
        a, b, c = yy / determinant, -xy / determinant, xx / determinant
        u, v = uvs[i, 0] * width - 0.5, uvs[i, 1] * height - 0.5
        reach_u, reach_v = math.sqrt(xx), math.sqrt(yy)
        total = 0.0
        for y in range(math.ceil(v - reach_v), math.floor(v + reach_v) + 1):
            for x in range(math.ceil(u - reach_u), math.floor(u + reach_u) + 1):
                tests[i] += 1
                p, q = x - u, y - v
                distance = a * p * p + 2 * b * p * q + c * q * q
                if distance > 1:
                    continue
                row, column = (y % height, x % width) if repeat else (
                    min(max(y, 0), height - 1),
                    min(max(x, 0), width - 1),
                )  # fmt: skip
                weight = math.exp(-2 * distance)
                total += weight
                reads[i] += 1
                for k in range(3):
                    colors[i, k] += weight * texels[offset + row * width + column, k]
        for k in range(3):
            colors[i, k] /= total
    return colors, reads, tests


@nb.njit(cache=True)
def _ellipse(jacobian, radius, ratio):
    """The matrix (xx, xy, yy) of an ellipse p' M^-1 p = 1, and its shorter semi-axis."""
    a, b, c, d = jacobian[0, 0], jacobian[0, 1], jacobian[1, 0], jacobian[1, 1]
    square = radius * radius
    xx, xy, yy = square * (a * a + b * b), square * (a * c + b * d), square * (c * c + d * d)
    longer = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)
    xx, xy, yy = _widen(xx, xy, yy, math.sqrt(longer) / ratio)
    shorter = 0.5 * (xx + yy) - math.hypot(0.5 * (xx - yy), xy)
    return xx, xy, yy, math.sqrt(max(shorter, 0.0))


@nb.njit(cache=True)
def _widen(xx, xy, yy, least):
    """The matrix of the ellipse after its semi-axes are lengthened to at least `least`."""
    middle, spread = 0.5 * (xx + yy), math.hypot(0.5 * (xx - yy), xy)
    long, short = max(middle + spread, least * least), max(middle - spread, least * least)
    if spread == 0.0:
        return long, 0.0, long
    # The new matrix is a weighted sum of the unit matrix and the old matrix's traceless part.
    factor = 0.5 * (long - short) / spread
    half = 0.5 * (long + short)
    return half + factor * 0.5 * (xx - yy), factor * xy, half - factor * 0.5 * (xx - yy)
