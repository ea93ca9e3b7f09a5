"""The function `compare`, which compares an image with an expected image by every measure."""

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float32, Float64

from .flip import INSTALL, mean_flip
from .picture import difference_picture
from .pixels import comparable_pixels, pixel_difference
from .similarity import psnr, ssim
from .tolerance import ONE_LEVEL, checked_tolerance, exceeds

_WORST = 5
"""Maximum number of pixels in `Comparison.worst_pixels`."""


class WorstPixel(NamedTuple):
    """A pixel that differs: its row and column, from 0, and the largest of its differences."""

    row: int
    column: int
    difference: float


@dataclass(frozen=True, eq=False)
class Comparison:
    """Measures of how much an image differs from the expected one. `str` gives a short table.

    Differences are absolute, and 1 is the full range of an image.

    - `tolerance`: largest difference of a channel at which two pixels count as equal, apart from
      rounding (`tolerance.exceeds`).
    - `max_difference`, `mean_difference`, `rmse`: largest, mean and root-mean-square difference
      over all pixels and channels.
    - `psnr`: peak signal-to-noise ratio in dB for a peak of 1; infinite for equal images.
    - `ssim`: structural similarity, in -1..1; 1 for equal images.
    - `flip`: mean FLIP at 67 pixels per degree, in 0..1; 0 for equal images. None if
      `flip-evaluator` is not installed (`pip install "softras2d[compare]"`).
    - `differing_pixels`: number of pixels with a channel that differs by more than the tolerance.
    - `worst_pixels`: the five pixels, or fewer, that differ most, the worst first; pixels that are
      equal are left out.
    - `difference`: the largest difference among the channels of each pixel.
    - `picture`: RGB, with pixels that differ by more than the tolerance coloured from red to white,
      over a dark grey copy of the expected image.
    """

    tolerance: float
    max_difference: float
    mean_difference: float
    rmse: float
    psnr: float
    ssim: float
    flip: float | None
    differing_pixels: int
    worst_pixels: tuple[WorstPixel, ...]
    difference: Float64[np.ndarray, "height width"] = field(repr=False)
    picture: Float32[np.ndarray, "height width 3"] = field(repr=False)

    @property
    def matches(self) -> bool:
        """Whether no pixel differs by more than the tolerance."""
        return self.differing_pixels == 0

    @property
    def differing_share(self) -> float:
        """Fraction, 0..1, of the pixels that differ by more than the tolerance."""
        return self.differing_pixels / self.difference.size

    def rows(self) -> list[tuple[str, str]]:
        """Return the name of every measure, and its value as text with its unit, for a table.

        The worst pixels have a row each, of which only the first has a name.
        """
        flip = f"not measured; {INSTALL}" if self.flip is None else f"{self.flip:.4g}"
        worst = [
            f"row {pixel.row}, column {pixel.column}: {pixel.difference:.4g}"
            for pixel in self.worst_pixels
        ]
        return [
            ("pixels that differ", self._differing()),
            ("largest difference", _in_levels(self.max_difference)),
            ("mean difference", _in_levels(self.mean_difference)),
            ("RMSE", _in_levels(self.rmse)),
            ("PSNR", f"{self.psnr:.2f} dB" if self.rmse else "infinite"),
            ("SSIM", f"{self.ssim:.5f}"),
            ("FLIP", flip),
            *(("" if index else "worst pixels", line) for index, line in enumerate(worst)),
        ]

    def _differing(self) -> str:
        """Text of the number and percentage of pixels that differ by more than the tolerance."""
        share = f"{self.differing_pixels:,} of {self.difference.size:,}"
        limit = _in_levels(self.tolerance)
        return f"{share} ({100 * self.differing_share:.3g} %), by more than {limit}"

    def __str__(self) -> str:
        rows = self.rows()
        width = max(len(name) for name, _ in rows)
        return "\n".join(f"{name:<{width}}  {value}" for name, value in rows)


def compare(actual: Any, expected: Any, *, tolerance: int | float = ONE_LEVEL) -> Comparison:
    """Measure how much the image `actual` differs from the image `expected`.

    - `actual`, `expected`: float images `[height, width, channels]` in 0..1, of NumPy or JAX, in
      sRGB, with 1, 3 or 4 channels. `read_image` reads them from files.
    - `tolerance`: largest difference of a channel at which two pixels count as equal, where 1 is
      the full range; by default one level of an 8-bit image, 1/255. It has an effect only on
      which pixels count as differing, and so on what the picture shows.

    Images of one channel are grey, and are converted to RGB. RGB images count as RGBA images with
    alpha 1. If one of the images is transparent somewhere, premultiplied colours and alpha are
    compared, four channels in all; otherwise RGB alone. FLIP composites images with alpha over
    white.

    Raises `ValueError`, with a message of one line, for images of different heights or widths, for
    arrays that are not float images, for NaN and infinity, and for a tolerance that is negative or
    not finite.
    """
    tolerance = checked_tolerance(tolerance)
    image, target = comparable_pixels(actual, expected)
    errors = image - target
    difference = pixel_difference(image, target)
    try:
        flip = mean_flip(image, target)
    except ImportError:
        flip = None
    return Comparison(
        tolerance=tolerance,
        max_difference=float(difference.max()),
        mean_difference=float(np.abs(errors).mean()),
        rmse=float(np.sqrt(np.square(errors).mean())),
        psnr=float(psnr(image, target)),
        ssim=float(ssim(image, target)),
        flip=flip,
        differing_pixels=int(exceeds(difference, tolerance).sum()),
        worst_pixels=_worst_pixels(difference),
        difference=difference,
        picture=difference_picture(difference, target, tolerance),
    )


def _worst_pixels(difference: Float64[np.ndarray, "height width"]) -> tuple[WorstPixel, ...]:
    """Find the pixels with the largest differences above 0, largest first, at most `_WORST` (5).

    Pixels of equal difference are in row order.
    """
    order = np.argsort(-difference, axis=None, kind="stable")[:_WORST]
    rows, columns = np.unravel_index(order, difference.shape)
    return tuple(
        WorstPixel(int(row), int(column), float(difference[row, column]))
        for row, column in zip(rows, columns, strict=True)
        if difference[row, column] > 0
    )


def _in_levels(difference: float) -> str:
    """Text of a difference in 0..1, followed by the same difference in 8-bit levels, 0..255."""
    return f"{difference:.4g} ({255 * difference:.3g} of 255 levels)"
