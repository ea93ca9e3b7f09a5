"""Measures how much the picture of an SVG file in a browser differs from the expected image."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32

from ..color import premultiply
from ..io.images import decode_image
from ..io.pixel_values import round_to_levels
from .chromium import TIME_LIMIT, screenshot_file
from .pixels import comparable_pixels, on_white, pixel_difference
from .similarity import psnr
from .tolerance import exceeds

FAR_LEVELS = 24
"""Difference of a channel, in levels of an 8-bit image, above which a pixel counts for
`ScreenshotDifference.far_share`.

Antialiasing alone causes larger differences in few pixels only."""


class ScreenshotDifference(NamedTuple):
    """Measures of how much a screenshot differs from the expected image, with 8 bits per channel.

    - `mean`, `largest`: mean and largest absolute difference over all pixels and channels, in
      levels, 0..255.
    - `far_share`: fraction, 0..1, of the pixels with a channel that differs by more than
      `FAR_LEVELS`.
    - `psnr`: peak signal-to-noise ratio in dB; infinite for equal images.
    """

    mean: float
    largest: float
    far_share: float
    psnr: float

    def __str__(self) -> str:
        return (
            f"mean difference {self.mean:.2f} levels of 255, largest {self.largest:.0f}; "
            f"{100 * self.far_share:.3g} % of pixels differ by more than {FAR_LEVELS} levels; "
            f"PSNR {f'{self.psnr:.2f} dB' if self.mean else 'infinite'}"
        )


def screenshot(
    browser: str, svg: Path, *, height: int, width: int, seconds: int | float = TIME_LIMIT
) -> Float32[np.ndarray, "height width 3"]:
    """Take a picture of an SVG file as a browser shows it on a white page, in sRGB, 0..1.

    The arguments and errors are those of `chromium.screenshot_file`. The picture is cropped to
    `width` x `height` pixels. In addition, `OSError` is raised if it is smaller, and `ValueError`
    if it cannot be decoded.
    """
    data = screenshot_file(browser, svg, height=height, width=width, seconds=seconds)
    picture = decode_image(data, f"{browser}: the picture of {svg}")[:height, :width, :3]
    if picture.shape != (height, width, 3):
        rows, columns, _ = picture.shape
        raise OSError(
            f"{browser}: the picture of {svg} has {columns} x {rows} of {width} x {height} pixels."
        )
    return picture


def screenshot_difference(
    shown: Float32[np.ndarray, "height width 3"],
    expected: Float[np.ndarray, "height width channels"],
) -> ScreenshotDifference:
    """Measure how much a screenshot differs from the image that it should show.

    - `shown`: the picture that `screenshot` returned.
    - `expected`: image of the same size, in sRGB, with straight alpha if it has four channels. It
      is composited over white, as on the page, and rounded to 8 bits, so that a browser that draws
      it exactly differs in no pixel.
    """
    actual, target = comparable_pixels(shown, round_to_levels(on_white(premultiply(expected))))
    difference = 255 * pixel_difference(actual, target)
    return ScreenshotDifference(
        mean=255 * float(np.abs(actual - target).mean()),
        largest=float(difference.max()),
        far_share=float(exceeds(difference, float(FAR_LEVELS)).mean()),
        psnr=float(psnr(actual, target)),
    )
