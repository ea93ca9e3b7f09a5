"""Helpers that the libraries share: sampling labels, and conversion of bytes to images."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ..contestant import Contestant
from ..downsample import box

RATE = 4
ANTI_ALIASED = "anti-aliased"
ONE_SAMPLE = "1 sample"
LARGE = "4x4 canvas"
LARGE_ANTI_ALIASED = "4x4 canvas, anti-aliased"
CALLS_ALONE = "calls alone, on a 1 px canvas"


def contestant(
    family: str,
    sampling: str,
    draw: Callable[[], NDArray[np.uint8]],
    *,
    rate: int,
    reverse: bool = False,
) -> Contestant:
    """A contestant on one thread, whose `draw()` returns a canvas `rate` times as wide and high.

    The canvas has RGBA or (`reverse`) BGRA bytes. At rates above one, the time includes the box
    filter to floats; at rate one the result is bytes, as these libraries intend.
    """

    def draw_and_average() -> NDArray[np.float32]:
        return box(draw(), rate)

    def image(drawn: object) -> NDArray[np.float32]:
        floats = np.asarray(drawn)
        if floats.dtype == np.uint8:
            floats = floats.astype(np.float32) / np.float32(255)
        return np.ascontiguousarray(floats[..., [2, 1, 0]] if reverse else floats[..., :3])

    return Contestant(family, sampling, 1, draw if rate == 1 else draw_and_average, image)
