"""The colours of the bundled scenes, and ramps between them."""

import numpy as np

# A palette that stays apart under colour blindness (Okabe and Ito, *Color Universal Design*,
# 2008), between a paper and an ink.
PAPER, INK = "#f4ebdd", "#0f2742"
ORANGE, SKY, BLUE, VERMILION = "#e69f00", "#56b4e9", "#0072b2", "#d55e00"


def mix(stops: list[str], where: float) -> np.ndarray:
    """The colour at `where` in 0..1 of a ramp through evenly spaced `stops`, as RGB in 0..255."""
    colors = np.array([[int(stop[i : i + 2], 16) for i in (1, 3, 5)] for stop in stops])
    at = np.linspace(0.0, 1.0, len(stops))
    return np.array([np.interp(where, at, channel) for channel in colors.T])
