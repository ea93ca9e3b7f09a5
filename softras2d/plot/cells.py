"""New figures for images: a pixel of an image is a whole number of dots on the screen.

Otherwise some rows of pixels come out thicker than others, and the figure shows aliasing that the
image does not have.
"""

from collections.abc import Sequence

from .library import Axes, Figure, import_pyplot

_PAGE, _TALLEST = 960, 480
"""Dots: the width of a row of images and the height of one, if they are enlarged."""

_GAP, _LINE = 12, 22
"""Dots: between images, and for a line of type over them."""

_TICKS = 56
"""Dots: for the numbers and the name of an axis."""


def columns_for(count: int, width: int) -> int:
    """How many images, `width` pixels wide, stand beside each other: six at most."""
    most = min(count, 6, max(2, _PAGE // (width + _GAP)))
    rows = -(-count // most)
    return -(-count // rows)


def new_cells(
    count: int, columns: int, height: int, width: int, *, lines: int = 0, ticks: bool = False
) -> tuple[Figure, Sequence[Axes]]:
    """A figure with `count` axes, row by row, each for an image of `height` x `width` pixels.

    `lines` of type fit over each. `ticks` leaves room for numbered axes.
    """
    pyplot = import_pyplot()
    rows = -(-count // columns)
    enlarge = min(_PAGE / (columns * width), _TALLEST / height)
    if enlarge >= 1:
        scale = float(int(enlarge))
    else:
        # Larger than the page: one dot a pixel if that is bearable, else smaller than that.
        scale = 1.0 if columns == 1 and max(height, width) <= _PAGE else enlarge
    cell_height, cell_width = height * scale, width * scale
    beside = _TICKS if ticks else _GAP
    above = lines * _LINE + _GAP
    figure_width = columns * (cell_width + beside) + _GAP
    figure_height = rows * (cell_height + above + (_TICKS if ticks else 0)) + _GAP
    dpi = pyplot.rcParams["figure.dpi"]
    figure = pyplot.figure(figsize=(figure_width / dpi, figure_height / dpi), layout="none")
    made = []
    for index in range(count):
        row, column = divmod(index, columns)
        left = column * (cell_width + beside) + beside
        top = row * (cell_height + above + (_TICKS if ticks else 0)) + above
        bottom = figure_height - top - cell_height
        box = (
            left / figure_width,
            bottom / figure_height,
            cell_width / figure_width,
            cell_height / figure_height,
        )
        made.append(figure.add_axes(box))
    return figure, made
