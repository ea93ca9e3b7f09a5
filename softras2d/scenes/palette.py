"""Colours of the bundled scenes, and interpolation between them."""

import numpy as np
from jaxtyping import Float

# A light and a dark colour, for backgrounds and lines. The others can be told apart by colour-blind
# readers (Okabe and Ito, *Color Universal Design*, 2008).
PAPER, INK = "#f4ebdd", "#0f2742"
ORANGE, SKY, BLUE, VERMILION = "#e69f00", "#56b4e9", "#0072b2", "#d55e00"


def mix(stops: list[str], t: float) -> Float[np.ndarray, "3"]:
    """Interpolate linearly between evenly spaced colours; return RGB in 0..255.

    - `stops`: the colours, `#rrggbb`.
    - `t`: where to interpolate, from 0 at the first colour to 1 at the last.
    """
    colors = np.array([[int(stop[i : i + 2], 16) for i in (1, 3, 5)] for stop in stops])
    positions = np.linspace(0.0, 1.0, len(stops))
    return np.array([np.interp(t, positions, channel) for channel in colors.T])
