"""The schedule of a fit of layers: functions of `share`, the share of the fit that is done, 0..1.

- Until `GROWTH_END`, triangles are added where the error is largest. The number in use grows in
  proportion to the share to the power of 1.5.
- Then, until `_LAST_EXCHANGE`, triangles are exchanged: those whose removal raises the error least
  are removed, and as many are added where they lower the error most.
- After that, triangles are only moved and coloured by the solver. Near the end the learning rate
  falls.
- Meanwhile, the width of soft edges goes from its first to its last value until `_SHARPENED`.
"""

import numpy as np

GROWTH_END = 0.4
"""Share of the fit after which all triangles are in use, if enough of them lower the error."""

_MIN_TRIANGLES = 8
"""Number of triangles that are added at the very start, unless the fit may have only fewer."""

_FIRST_EXCHANGE_SHARE = 0.3
"""Fraction of the triangles that an exchange at the start of a fit would replace at most.

The fraction falls linearly to zero at the end of the fit."""

_EXCHANGE_INTERVAL, _LAST_EXCHANGE = 0.02, 0.85
"""Least share of the fit between two exchanges; and the share of the fit after which there are
none."""

_LEARNING_RATE = 0.025
"""First learning rate.

With this rate, a step of Adam changes a position by about half a pixel, or less, and a colour by
about 0.025, or less.
"""

_RATE_FALL, _FINAL_RATE_FACTOR = 0.3, 0.02
"""Share of the fit, at its end, during which the learning rate falls linearly; and the last
learning rate as a multiple of the first."""

_SHARPENED = 0.5
"""Share of the fit after which soft edges have their final width."""


def triangles_to_add(share: float, active: int, total: int) -> int:
    """Number of triangles to add at this share of the fit; 0 if it is not worth adding so few.

    The number that should be in use grows until `GROWTH_END`, as the module says. The missing
    triangles are added if they are at least a twentieth of `active`, or if they are the last ones.

    - `share`: share of the fit that is done, 0..1.
    - `active`: number of triangles in use.
    - `total`: number of triangles that should be in use from `GROWTH_END` on.
    """
    growth = min(1.0, share / GROWTH_END) ** 1.5
    wanted = int(min(total, max(_MIN_TRIANGLES, total * growth)))
    missing = max(0, wanted - active)
    # Few large additions are better than many small ones: each restarts second-order solvers.
    return missing if missing >= max(1, active // 20) or wanted == total else 0


def is_exchange_due(share: float, last_exchange: float) -> bool:
    """Whether an exchange of triangles is due at the share `share` of the fit that is done, 0..1.

    An exchange is due before `_LAST_EXCHANGE`, if a share of at least `_EXCHANGE_INTERVAL` has
    passed since the last one. The caller makes the exchange only if all triangles are in use.

    `last_exchange`: the share at the last exchange; 0 if there was none.
    """
    return share < _LAST_EXCHANGE and share - last_exchange >= _EXCHANGE_INTERVAL


def triangles_to_exchange(share: float, total: int) -> int:
    """Largest number of triangles, of `total`, to exchange at this share of the fit; at least 1.

    It falls linearly from `_FIRST_EXCHANGE_SHARE * total` to 0, rounded down but at least 1, as
    `share`, the share of the fit that is done, grows from 0 to 1.
    """
    return max(1, int(total * _FIRST_EXCHANGE_SHARE * (1 - share)))


def learning_rate(share: float) -> float:
    """Learning rate at a share of the fit, for a solver whose learning rate can be set.

    `share`: share of the fit that is done, 0..1. The learning rate is `_LEARNING_RATE` up to the
    share `1 - _RATE_FALL`, and then falls linearly towards 0 at share 1, but not below
    `_FINAL_RATE_FACTOR * _LEARNING_RATE`.
    """
    return _LEARNING_RATE * max(_FINAL_RATE_FACTOR, min(1.0, (1 - share) / _RATE_FALL))


def edge_width(share: float, softness: tuple[float, float]) -> np.float32:
    """Width of soft edges at a share of the fit that is done, 0..1, in pixels of the fit.

    The width changes geometrically from the first to the last width in `softness`, which it reaches
    at `_SHARPENED` and then keeps.
    """
    first, last = softness
    return np.float32(first * (last / first) ** min(1.0, share / _SHARPENED))
