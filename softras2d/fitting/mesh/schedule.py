"""The schedule of a fit of a mesh: functions of `share`, the share of the fit that is done, 0..1.

At each of the shares in `_EXCHANGES`, the vertices whose removal raises the squared error least are
moved to where they lower it most. During the fit the learning rate falls like half a cosine.
"""

import numpy as np

_EXCHANGES = (
    (0.1, 0.15), (0.2, 0.12), (0.3, 0.1), (0.4, 0.08), (0.5, 0.06), (0.6, 0.05), (0.7, 0.04),
)  # fmt: skip
"""For each exchange of vertices, the share of the fit at which it is due, and the fraction of the
vertices that it moves."""

_LEARNING_RATE = 0.03
"""First learning rate.

With this rate, a step of Adam changes a colour by about 0.03, and a position by about 0.6 pixels,
or less where `MeshData.scale` is below 20."""

_FINAL_RATE_FACTOR = 0.02
"""The last learning rate, as a multiple of the first."""


def vertices_to_exchange(share: float, last_exchange: float, vertices: int) -> int:
    """Number of vertices to exchange at the share `share` of the fit; 0 if no exchange is due.

    An exchange in `_EXCHANGES` is due if its share is above `last_exchange` and at most `share`. If
    several are due, only the last of them is made. If any is due, the number is at least 1.

    - `share`: share of the fit that is done, 0..1.
    - `last_exchange`: share of the fit at the last exchange; 0 if there was none.
    - `vertices`: number of vertices of the mesh.
    """
    fractions = [fraction for due, fraction in _EXCHANGES if last_exchange < due <= share]
    return max(1, int(fractions[-1] * vertices)) if fractions else 0


def learning_rate(share: float) -> float:
    """Learning rate at a share of the fit, for a solver whose learning rate can be set.

    It falls like half a cosine from `_LEARNING_RATE`, but not below `_FINAL_RATE_FACTOR` of that.
    `share`: share of the fit that is done, 0..1.
    """
    factor = max(_FINAL_RATE_FACTOR, 0.5 + 0.5 * np.cos(np.pi * share))
    return float(_LEARNING_RATE * factor)
