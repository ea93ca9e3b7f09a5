"""When things happen in a fit of a mesh, as functions of its share: how far it is, from 0 to 1.

At each of the shares in `_EXCHANGES`, vertices whose removal costs least are moved to where they
gain more. Meanwhile the learning rate falls as a cosine.
"""

import numpy as np

_EXCHANGES = (
    (0.1, 0.15), (0.2, 0.12), (0.3, 0.1), (0.4, 0.08), (0.5, 0.06), (0.6, 0.05), (0.7, 0.04),
)  # fmt: skip
"""Exchanges: (share of the fit, fraction of the vertices that is exchanged)."""

_LEARNING_RATE = 0.03
"""A step of Adam changes a position by up to 0.6 pixels and a colour by up to 0.03."""

_FINAL_RATE_FACTOR = 0.02
"""The last learning rate, as a multiple of the first."""


def vertices_to_exchange(share: float, last_exchange: float, vertices: int) -> int:
    """Number of vertices to exchange now, after an exchange at `last_exchange`; 0 if none is due.

    If several exchanges are due, only the last one is made.
    """
    fractions = [fraction for due, fraction in _EXCHANGES if last_exchange < due <= share]
    return max(1, int(fractions[-1] * vertices)) if fractions else 0


def learning_rate(share: float) -> float:
    """Learning rate of a solver whose learning rate can be set."""
    factor = max(_FINAL_RATE_FACTOR, 0.5 + 0.5 * np.cos(np.pi * share))
    return float(_LEARNING_RATE * factor)
