"""Shrink images, with the mean over the area of each new pixel."""

import numpy as np
from jaxtyping import Float


def shrink(
    image: Float[np.ndarray, "rows columns channels"], height: int, width: int
) -> Float[np.ndarray, "{height} {width} channels"]:
    """Shrink an image to `height` x `width`; exact for any ratio.

    Each pixel is a square of constant colour. Colours with straight alpha are weighted by alpha.
    """
    if image.shape[:2] == (height, width):
        return image
    values = image
    if image.shape[-1] == 4:
        values = np.concatenate([image[..., :3] * image[..., 3:], image[..., 3:]], -1)
    rows, columns = _overlaps(image.shape[0], height), _overlaps(image.shape[1], width)
    mean = np.einsum("ri,ijc,kj->rkc", rows, values, columns, optimize=True)
    if image.shape[-1] == 4:
        alpha = mean[..., 3:]
        color = np.divide(mean[..., :3], alpha, out=np.zeros_like(mean[..., :3]), where=alpha > 0)
        mean = np.concatenate([color, alpha], -1)
    return mean.astype(image.dtype)


def _overlaps(old: int, new: int) -> Float[np.ndarray, "{new} {old}"]:
    """Share of each new pixel that each old pixel fills, along one axis."""
    edges = np.linspace(0, old, new + 1)
    low = np.maximum(edges[:-1, None], np.arange(old))
    high = np.minimum(edges[1:, None], np.arange(1, old + 1))
    return np.maximum(high - low, 0) * (new / old)
