"""The schedule of a fit of layers: functions of `share`, the share of the fit that is done, 0..1.

- Until `GROWTH_END`, triangles are added where the error is largest.
- Then, until `_LAST_EXCHANGE`, triangles whose removal raises the error least are moved to where
  they lower it more.
- After that, triangles are only fitted. Near the end the learning rate falls.
- Meanwhile, soft edges become sharper until `_SHARPENED`.
"""

import numpy as np

GROWTH_END = 0.4
"""Share of the fit after which all triangles are in use."""

_MIN_TRIANGLES = 8
"""Least number of triangles that are added at the very start, if the fit may have so many."""

_FIRST_EXCHANGE_SHARE = 0.3
"""Fraction of the triangles that an exchange at the start of a fit would move at most.

It falls linearly to zero at the end of the fit."""

_EXCHANGE_INTERVAL, _LAST_EXCHANGE = 0.02, 0.85
"""Share of the fit between two exchanges, and share after which there are none."""

_LEARNING_RATE = 0.025
"""First learning rate.

With it, a step of Adam changes a position by up to half a pixel and a colour by up to 0.025."""

_RATE_FALL, _FINAL_RATE_FACTOR = 0.3, 0.02
"""Share of the fit, at its end, in which the learning rate falls linearly; and the last learning
rate as a multiple of the first."""

_SHARPENED = 0.5
"""Share of the fit after which soft edges have their final width."""


def triangles_to_add(share: float, active: int, total: int) -> int:
    """Number of triangles to add now; 0 if there are too few to be worth an addition.

    - `active`: number of triangles in use.
    - `total`: number of triangles in use from `GROWTH_END` on.
    """
    growth = min(1.0, share / GROWTH_END) ** 1.5
    wanted = int(min(total, max(_MIN_TRIANGLES, total * growth)))
    missing = max(0, wanted - active)
    # Few large additions are better than many small ones: each restarts second-order solvers.
    return missing if missing >= max(1, active // 20) or wanted == total else 0


def is_exchange_due(share: float, last_exchange: float) -> bool:
    """Whether an exchange is due. The last one was at the share `last_exchange`; 0 if none was."""
    return share < _LAST_EXCHANGE and share - last_exchange >= _EXCHANGE_INTERVAL


def triangles_to_exchange(share: float, total: int) -> int:
    """Largest number of triangles, of `total`, that an exchange moves now; at least 1."""
    return max(1, int(total * _FIRST_EXCHANGE_SHARE * (1 - share)))


def learning_rate(share: float) -> float:
    """Learning rate of a solver whose learning rate can be set."""
    return _LEARNING_RATE * max(_FINAL_RATE_FACTOR, min(1.0, (1 - share) / _RATE_FALL))


def edge_width(share: float, softness: tuple[float, float]) -> np.float32:
    """Width of soft edges, in pixels of the fit.

    It goes geometrically from the first to the last width of `softness`, and stays there.
    """
    first, last = softness
    return np.float32(first * (last / first) ** min(1.0, share / _SHARPENED))
