"""Fit the exponent with which a cost grows: the slope of log cost against log size."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Fit(NamedTuple):
    """`cost = scale size ** exponent`, fitted to the sizes from `first` to `last`.

    `error` is the standard error of the exponent; NaN for two sizes.
    """

    exponent: float
    error: float
    scale: float
    first: float
    last: float

    def __str__(self) -> str:
        return f"{self.exponent:.2f}" + ("" if np.isnan(self.error) else f" ± {self.error:.2f}")


def fit(sizes: Sequence[float], costs: Sequence[float]) -> Fit | None:
    """Fit by least squares over the upper half of the sizes, on a log scale; None for one size.

    The upper half begins at the geometric mean of the least and the greatest.
    """
    middle = np.sqrt(min(sizes) * max(sizes)) if sizes else 0.0
    # Rounding must not exclude the size in the middle.
    upper = [(s, c) for s, c in zip(sizes, costs, strict=True) if s >= 0.99 * middle]
    if len(upper) < 2:
        return None
    x, y = np.log(np.array(upper, np.float64)).T
    spread = x - x.mean()
    exponent = spread @ y / (spread @ spread)
    left = y - y.mean() - exponent * spread
    free = len(x) - 2
    error = np.sqrt(left @ left / free / (spread @ spread)) if free else np.nan
    scale = np.exp(y.mean() - exponent * x.mean())
    return Fit(float(exponent), float(error), float(scale), upper[0][0], upper[-1][0])
