"""An oracle for texture lookups, written from the definitions in float64 NumPy.

It shares no code with the package. Texels are premultiplied RGBA. Points have texture coordinates
`uv` `[points, 2]` and Jacobians `[points, 2, 2]`, the derivatives of (u, v) with respect to (x, y)
in pixels.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

ROUNDING = 2.0**-10
"""Subtracted from the ratio of a footprint's axes before it is rounded up to a number of probes."""


@dataclass(frozen=True)
class Sampler:
    """How textures are sampled; options as in `softras2d.Filter` and `TexturePyramid.build`."""

    pixel: str = "bilinear"
    level: str = "linear"
    anisotropy: int = 1
    lod_bias: float = 0.0
    border: str = "clamp"
    addressing: str = "half_texel"


PLAIN = Sampler()


def chain(image: Any) -> list[np.ndarray]:
    """All mip levels of an image in RGB or straight RGBA, finest first.

    Each level is `[height, width, 4]`, premultiplied.
    """
    levels = [premultiplied(np.asarray(image, np.float64))]
    while max(levels[-1].shape[:2]) > 1:
        height, width = levels[-1].shape[:2]
        levels.append(np.einsum("ij,kl,jlc->ikc", reduction(height), reduction(width), levels[-1]))
    return levels


def reduction(size: int) -> np.ndarray:
    """The matrix `[half, size]` of a box filter that halves the number of texels.

    The interval 0..1 is cut into `size` texels, and into `half` larger ones. A larger texel is the
    average over its part of the interval, for even and odd sizes.
    """
    half = max(size // 2, 1)
    fine, coarse = np.arange(size + 1) / size, np.arange(half + 1) / half
    start = np.maximum(coarse[:-1, None], fine[None, :-1])
    end = np.minimum(coarse[1:, None], fine[None, 1:])
    return np.maximum(end - start, 0) * half


def premultiplied(color: np.ndarray) -> np.ndarray:
    """Convert RGB or straight RGBA to premultiplied RGBA."""
    alpha = color[..., 3:] if color.shape[-1] == 4 else np.ones((*color.shape[:-1], 1))
    return np.concatenate([color[..., :3] * alpha, alpha], axis=-1)


def sample(
    levels: list[np.ndarray], uv: np.ndarray, jacobian: np.ndarray, sampler: Sampler
) -> tuple[np.ndarray, np.ndarray]:
    """Premultiplied texels `[points, 4]`, and margins `[points]` to the nearest jump.

    Lookups jump where another texel, another level or another number of probes is chosen. The
    margin is the least of the distances to these jumps: in texels of the level, in levels, and in
    the ratio of the footprint's axes. It is infinite if the lookup has no jumps.
    """
    height, width = levels[0].shape[:2]
    size = np.array([width, height], np.float64)
    # The derivative of (u W, v H) with respect to (x, y), in texels of the finest level.
    footprint = jacobian * size[:, None]
    if sampler.anisotropy == 1:
        axis, probes = np.zeros_like(uv), np.ones(len(uv))
        length, margin = np.linalg.norm(footprint, axis=1).max(axis=-1), np.full(len(uv), np.inf)
    else:
        axis, probes, length, margin = _major_axis(footprint, sampler.anisotropy)
    with np.errstate(divide="ignore"):
        detail = np.log2(length / probes) + sampler.lod_bias
    level = np.where(length > 0, np.clip(detail, 0, len(levels) - 1), 0.0)
    total = np.zeros((len(uv), 4))
    for k in range(sampler.anisotropy):
        is_probed = k < probes
        probe_uv = uv + ((k + 0.5) / probes - 0.5)[:, None] * axis / size
        texel, probe_margin = _between_levels(levels, probe_uv, level, sampler)
        total += np.where(is_probed[:, None], texel, 0)
        margin = np.minimum(margin, np.where(is_probed, probe_margin, np.inf))
    return total / probes[:, None], margin


def _major_axis(footprint: np.ndarray, most: int) -> tuple[np.ndarray, ...]:
    """The longer axis of each footprint, the number of probes, its length, and the margin.

    The axis and its length are in texels of the finest level, from the eigenvectors of J J^T. The
    margin is how far the ratio of the axes is from another number of probes.
    """
    product = footprint @ footprint.transpose(0, 2, 1)
    values, vectors = np.linalg.eigh(product)
    # The determinant, over the longer axis, gives the shorter axis without cancellation.
    longer = np.sqrt(np.maximum(values[:, 1], 0))
    shorter = np.abs(np.linalg.det(footprint)) / np.where(longer > 0, longer, 1)
    ratio = np.where(shorter > 0, longer / np.where(shorter > 0, shorter, 1), np.inf)
    ratio = np.where(longer > 0, ratio, 1)
    probes = np.clip(np.ceil(ratio - ROUNDING), 1, most)
    margin = np.abs(ratio[:, None] - ROUNDING - np.arange(1, most)).min(axis=1)
    margin = np.where(longer > 0, margin, np.inf)
    return vectors[:, :, 1] * longer[:, None], probes, longer, margin


def _between_levels(
    levels: list[np.ndarray], uv: np.ndarray, level: np.ndarray, sampler: Sampler
) -> tuple[np.ndarray, np.ndarray]:
    """Texel and margin of one probe, from one level or blended from two."""
    last = len(levels) - 1
    if sampler.level == "zero":
        return _on_level(levels, uv, np.zeros(len(uv), int), sampler)
    if sampler.level == "nearest":
        texel, margin = _on_level(levels, uv, np.floor(level + 0.5).astype(int), sampler)
        switch = np.abs(level[:, None] - (np.arange(last) + 0.5)).min(axis=1, initial=np.inf)
        return texel, np.minimum(margin, switch)
    lower = np.floor(level).astype(int)
    fine, fine_margin = _on_level(levels, uv, lower, sampler)
    coarse, coarse_margin = _on_level(levels, uv, np.minimum(lower + 1, last), sampler)
    fraction = (level - lower)[:, None]
    # A jump within a level of zero weight does not change the result.
    coarse_margin = np.where(fraction[:, 0] > 0, coarse_margin, np.inf)
    return (1 - fraction) * fine + fraction * coarse, np.minimum(fine_margin, coarse_margin)


def _on_level(
    levels: list[np.ndarray], uv: np.ndarray, level: np.ndarray, sampler: Sampler
) -> tuple[np.ndarray, np.ndarray]:
    """Texel and margin of each point, read from one level per point, an integer."""
    texel, margin = np.zeros((len(uv), 4)), np.full(len(uv), np.inf)
    for index in np.unique(level):
        chosen = level == index
        texel[chosen], margin[chosen] = _on_image(levels[index], uv[chosen], sampler)
    return texel, margin


def _on_image(image: np.ndarray, uv: np.ndarray, sampler: Sampler) -> tuple[np.ndarray, np.ndarray]:
    height, width = image.shape[:2]
    columns, across, column_margin = _taps(uv[:, 0], width, sampler)
    rows, down, row_margin = _taps(uv[:, 1], height, sampler)
    texel = np.zeros((len(uv), 4))
    for row, row_weight in zip(rows, down, strict=True):
        for column, column_weight in zip(columns, across, strict=True):
            texel += (row_weight * column_weight)[:, None] * image[row, column]
    return texel, np.minimum(column_margin, row_margin)


def _taps(u: np.ndarray, size: int, sampler: Sampler) -> tuple[Any, Any, np.ndarray]:
    """The texels to blend along one axis of `size` texels: indices, weights and the margin."""
    repeat, corners = sampler.border == "repeat", sampler.addressing == "corners"
    seam = np.full(u.shape, np.inf)
    if corners:
        if repeat:
            if size > 1:
                seam = np.abs(u - np.rint(u)) * size
            u = u - np.floor(u)
        x = u * (size - 1)
    else:
        x = u * size - 0.5

    def wrap(index: np.ndarray) -> np.ndarray:
        index = index.astype(int)
        return index % size if repeat and not corners else np.clip(index, 0, size - 1)

    if sampler.pixel == "nearest":
        switch = np.rint(x + 0.5)  # the nearest border, between texels `switch` - 1 and `switch`
        exists = (wrap(switch) != wrap(switch - 1)) & (size > 1)
        margin = np.where(exists, np.abs(x + 0.5 - switch), np.inf)
        return [wrap(np.floor(x + 0.5))], [np.ones_like(u)], np.minimum(margin, seam)
    first = np.floor(x)
    return [wrap(first), wrap(first + 1)], [1 - (x - first), x - first], seam
