"""Smooth random fields on grids, and lookups in them, from which all the pictures are made."""

import numpy as np


def smooth(ys: np.ndarray, xs: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Noise with cells of unit size at all pairs of coordinates, which need not be evenly spaced.

    It is a cubic B-spline of normally distributed values at the integers, with mean 0 and standard
    deviation about 1. The spline is separable, so a grid of any size takes two matrix products.
    """
    rows, columns = _weights(ys), _weights(xs)
    values = rng.standard_normal((rows.shape[1], columns.shape[1]))
    # The mean over positions of the sum of squared weights along one axis is 151 / 315.
    return rows @ values @ columns.T * (315 / 151)


def fractal(
    ys: np.ndarray, xs: np.ndarray, rng: np.random.Generator, octaves: int, gain: float = 0.5
) -> np.ndarray:
    """Sum octaves of `smooth`, each with half the cell size and `gain` times the height."""
    parts = [gain**k * smooth(ys * 2**k, xs * 2**k, rng) for k in range(octaves)]
    return sum(parts, np.zeros((len(ys), len(xs)))) * (1 - gain**2) ** 0.5


def ridged(
    ys: np.ndarray, xs: np.ndarray, rng: np.random.Generator, octaves: int, gain: float = 0.5
) -> np.ndarray:
    """Mountains in about 0..1: octaves folded to sharp crests, finer octaves only on higher ground.

    **Source:** Musgrave's ridged multifractal, in Ebert et al., *Texturing and Modeling: A
    Procedural Approach* (2003), chapter 16.
    """
    height, weight = np.zeros((len(ys), len(xs))), np.ones((len(ys), len(xs)))
    for k in range(octaves):
        crest = np.clip(1 - 0.8 * np.abs(smooth(ys * 2**k, xs * 2**k, rng)), 0, 1) ** 2
        height += gain**k * weight * crest
        weight = np.clip(1.7 * crest, 0.15, 1)
    return height * (1 - gain)


def look_up(field: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Read `field[height, width, ...]` bilinearly; integer coordinates are its values, clamped."""
    rows = np.clip(rows, 0, field.shape[0] - 1.001)
    columns = np.clip(columns, 0, field.shape[1] - 1.001)
    top, left = rows.astype(np.int32), columns.astype(np.int32)
    down, right = rows - top, columns - left
    if field.ndim == 3:
        down, right = down[..., None], right[..., None]
    upper = field[top, left] * (1 - right) + field[top, left + 1] * right
    lower = field[top + 1, left] * (1 - right) + field[top + 1, left + 1] * right
    return upper * (1 - down) + lower * down


def ramp(x: np.ndarray, start: float | np.ndarray, end: float | np.ndarray) -> np.ndarray:
    """A smooth step from 0 at `start` to 1 at `end`; `end` may be less than `start`."""
    t = np.clip((x - start) / (end - start), 0, 1)
    return t * t * (3 - 2 * t)


def mix(first: np.ndarray, second: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Interpolate colours `[..., 3]` or numbers, from `first` at share 0 to `second` at share 1."""
    return first + (second - first) * share


def _weights(coordinates: np.ndarray) -> np.ndarray:
    """Cubic B-spline weights `[coordinates, lattice]`."""
    first = np.floor(coordinates).astype(int)
    t = coordinates - first
    base = first - first.min()
    weights = np.zeros((len(coordinates), base.max() + 4))
    parts = (
        (1 - t) ** 3 / 6,
        (3 * t**3 - 6 * t**2 + 4) / 6,
        (-3 * t**3 + 3 * t**2 + 3 * t + 1) / 6,
        t**3 / 6,
    )
    for k, part in enumerate(parts):
        weights[np.arange(len(coordinates)), base + k] = part
    return weights
