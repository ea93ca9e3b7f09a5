"""A texture with the statistics of a photograph, and a scene of smaller and smaller copies of it.

Discs that hide each other, with the density r^-3 of radii r, have edges at all scales and the 1/f^2
power spectrum of natural images.

**Source:** Lee, Mumford and Huang, *Occlusion Models for Natural Images: A Statistical Study of a
Scale-Invariant Dead Leaves Model* (IJCV 41, 2001).
"""

import numpy as np

import softras2d as sr

TEXELS = 512
_LEAST, _MOST = 1.5, 130.0
"""Radii of discs in texels."""

COPIES = (
    (104.0, 104.0, 180.0, 8.0),
    (246.0, 66.0, 88.0, -20.0),
    (244.0, 170.0, 72.0, 33.0),
    (44.0, 250.0, 60.0, 0.0),
    (116.0, 252.0, 46.0, 45.0),
    (176.0, 254.0, 34.0, 12.0),
    (224.0, 256.0, 24.0, -30.0),
    (266.0, 258.0, 16.0, 5.0),
)
"""Middle (x, y) and side of each copy, in pixels, and the degrees by which it is turned."""


def picture(seed: int, count: int = 6000) -> np.ndarray:
    """The texture `[512, 512, 3]` in 0..1: discs lit from above, later discs in front."""
    rng = np.random.default_rng(seed)
    # The inverse of the distribution function of r^-3 between two radii.
    share = rng.random(count)
    radius = (_LEAST**-2 + share * (_MOST**-2 - _LEAST**-2)) ** -0.5
    radius[: count // 100] = _MOST
    middle = rng.uniform(-0.1, 1.1, (count, 2)) * TEXELS
    tone, hue = rng.beta(1.3, 1.6, count), rng.random(count)
    image = np.full((TEXELS, TEXELS, 3), 0.4, np.float32)
    for (x, y), r, light, turn in zip(middle, radius, tone, hue, strict=True):
        left, right = _reach(x, r)
        top, bottom = _reach(y, r)
        across = (np.arange(left, right) + 0.5 - x)[None, :] / r
        down = (np.arange(top, bottom) + 0.5 - y)[:, None] / r
        inside = across**2 + down**2 < 1
        shade = light * (1 - 0.35 * down) + 0.05 * across
        tint = 1 + 0.3 * np.cos(2 * np.pi * (turn + np.arange(3) / 3))
        colored = np.clip(shade[..., None] * tint, 0, 1)
        part = image[top:bottom, left:right]
        part[inside] = colored[inside]
    return image


def scene(seed: int) -> sr.Scene:
    """The picture as thumbnails, from 2.8 to 32 texels per pixel."""
    square = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    halves = [[0, 1, 2], [0, 2, 3]]
    corners, uv = [], []
    for x, y, side, degrees in COPIES:
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        corners.append((square * side @ np.array([[c, s], [-s, c]]) + (x, y))[halves])
        uv.append((square + 0.5)[halves])
    count = 2 * len(COPIES)
    return sr.Scene.from_soup(
        np.concatenate(corners).astype(np.float32),
        np.ones((count, 3), np.float32),
        uv=np.concatenate(uv),
        texture_index=np.zeros(count, int),
        textures=sr.TexturePyramid.build([picture(seed)]),
        background=np.ones(3, np.float32),
    )


def _reach(middle: float, radius: float) -> tuple[int, int]:
    """The range of texels that a disc can touch along an axis."""
    first, last = np.clip([middle - radius, middle + radius + 1], 0, TEXELS).astype(int)
    return first, last
