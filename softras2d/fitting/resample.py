"""Shrink images: each new pixel is the mean over the area that it covers in the old image."""

import numpy as np
from jaxtyping import Float

_BLOCK_ROWS = 8
"""Number of new rows that are computed together; more rows would multiply by more zeros."""


def shrink(
    image: Float[np.ndarray, "rows columns channels"], height: int, width: int
) -> Float[np.ndarray, "{height} {width} channels"]:
    """Shrink an image to `height` x `width` pixels by exact means, for any ratio of the sizes.

    Neither may exceed the size of the image. The result has the image's type. Each old pixel is a
    square of constant colour. If there are four channels, the last is straight alpha, and colours
    are weighted by it; colours are 0 where the mean alpha is 0. An image that has the requested
    size is returned unchanged.
    """
    if image.shape[:2] == (height, width):
        return image
    values = image
    if image.shape[-1] == 4:
        values = np.concatenate([image[..., :3] * image[..., 3:], image[..., 3:]], -1)
    mean = _shrink_columns(_shrink_rows(values, height), width)
    if image.shape[-1] == 4:
        alpha = mean[..., 3:]
        color = np.divide(mean[..., :3], alpha, out=np.zeros_like(mean[..., :3]), where=alpha > 0)
        mean = np.concatenate([color, alpha], -1)
    return mean.astype(image.dtype)


def _shrink_columns(
    values: Float[np.ndarray, "rows columns channels"], width: int
) -> Float[np.ndarray, "rows {width} channels"]:
    """Shrink an image along each row, to `width` columns, by means over areas."""
    columns = _overlaps(values.shape[1], width)
    return np.einsum("rjc,kj->rkc", values, columns, optimize=True)


def _shrink_rows(
    values: Float[np.ndarray, "rows columns channels"], height: int
) -> Float[np.ndarray, "{height} columns channels"]:
    """Shrink an image along each column, to `height` rows, by means over areas.

    Each block of new rows reads only the old rows that it overlaps.
    """
    old = values.shape[0]
    overlaps = _overlaps(old, height)
    blocks = []
    for first in range(0, height, _BLOCK_ROWS):
        last = min(first + _BLOCK_ROWS, height)
        low, high = first * old // height, -(-last * old // height)
        share = overlaps[first:last, low:high]
        blocks.append(np.einsum("ri,ijc->rjc", share, values[low:high], optimize=True))
    return np.concatenate(blocks)


def _overlaps(old: int, new: int) -> Float[np.ndarray, "{new} {old}"]:
    """Fraction of each new pixel that each old pixel covers, along one axis of an image.

    `old`, `new`: number of pixels along the axis before and after shrinking. Each row of the result
    sums to 1.
    """
    edges = np.linspace(0, old, new + 1)
    low = np.maximum(edges[:-1, None], np.arange(old))
    high = np.minimum(edges[1:, None], np.arange(1, old + 1))
    return np.maximum(high - low, 0) * (new / old)
