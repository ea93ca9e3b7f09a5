"""Box filter that turns a library's large canvas into its supersampled image."""

# pyright: reportMissingImports=false

from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray


def box(canvas: NDArray[np.uint8], rate: int) -> NDArray[np.float32]:
    """Mean of `rate` x `rate` pixels: `[height * rate, width * rate, 3 or 4]` bytes to floats 0..1.

    The function is compiled, runs on one thread and sums integers. Four channels at rate 4 take a
    path that adds two channels in one 32-bit word. Channels keep their order; a fourth channel is
    dropped.
    """
    height, width, channels = canvas.shape
    out = np.empty((height // rate, width // rate, 3), np.float32)
    if rate == 4 and channels == 4:
        _box_words(canvas.view(np.uint32)[..., 0], out)
    else:
        _box(canvas, rate, out)
    return out


@nb.njit(cache=True)
def _box(canvas: Any, rate: int, out: Any) -> None:
    scale = np.float32(1.0 / (255.0 * rate * rate))
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            for k in range(3):
                total = 0
                for j in range(y * rate, (y + 1) * rate):
                    for i in range(x * rate, (x + 1) * rate):
                        total += canvas[j, i, k]
                out[y, x, k] = total * scale


@nb.njit(cache=True)
def _box_words(canvas: Any, out: Any) -> None:
    """Sum two channels at once: sixteen bytes sum to less than 2^16, so the sums do not overlap."""
    scale = np.float32(1.0 / (255.0 * 16))
    even, low = np.uint32(0x00FF00FF), np.uint32(0x000000FF)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            zero_two, one = np.uint32(0), np.uint32(0)
            for j in range(4 * y, 4 * y + 4):
                for i in range(4 * x, 4 * x + 4):
                    word = canvas[j, i]
                    zero_two += word & even
                    one += (word >> np.uint32(8)) & low
            out[y, x, 0] = np.float32(zero_two & np.uint32(0xFFFF)) * scale
            out[y, x, 1] = np.float32(one) * scale
            out[y, x, 2] = np.float32(zero_two >> np.uint32(16)) * scale
