"""matplotlib, imported when it is first needed, and its types."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

    AnyFigure = Figure | SubFigure
else:
    # For those who read annotations at run time, as the tests do: no import for a type.
    Axes = Figure = AnyFigure = Any

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Told apart by the colour-blind too.

**Source:** Okabe and Ito, *Color Universal Design* (2008), without its yellow.
"""


def import_pyplot() -> Any:
    """`matplotlib.pyplot`. Raises `ImportError`, one line, if matplotlib is not installed."""
    try:
        from matplotlib import pyplot
    except ModuleNotFoundError as missing:
        raise ImportError(
            f'softras2d.plot needs matplotlib: pip install "softras2d[plot]" ({missing}).'
        ) from missing
    return pyplot
