"""Imports matplotlib when it is first needed, and names its types without importing it."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

    AnyFigure = Figure | SubFigure
else:
    # Annotations are evaluated at run time too, where a type alone must not import matplotlib.
    Axes = Figure = AnyFigure = Any

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Colours for lines, which colour-blind readers can tell apart.

**Source:** Okabe and Ito, *Color Universal Design* (2008), without its yellow."""


def import_pyplot() -> Any:
    """Import `matplotlib.pyplot`, and return it.

    Raises `ImportError`, with a message of one line, if matplotlib is missing.
    """
    try:
        from matplotlib import pyplot
    except ModuleNotFoundError as missing:
        raise ImportError(
            f'softras2d.plot needs matplotlib: pip install "softras2d[plot]" ({missing}).'
        ) from missing
    return pyplot
