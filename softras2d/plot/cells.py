"""Makes figures in which each pixel of an image is an integer number of screen dots wide and high.

Otherwise some rows of pixels would be thicker than others, and the figure would show aliasing that
the image does not have. Images that are too large for this are shrunk (`new_cells`). All sizes
are in dots of the screen, unless they are in pixels of an image.
"""

from collections.abc import Sequence

from .library import Axes, Figure, import_pyplot

_MAX_ROW_WIDTH, _MAX_HEIGHT = 960, 480
"""Limits up to which images are enlarged, in dots: width of a row of images, and height of one
image."""

_GAP, _LINE_HEIGHT = 12, 22
"""Space between images, and height of one line of a title, in dots."""

_TICKS = 56
"""Space for the numbers and the label of an axis, in dots."""


def columns_for(count: int, width: int) -> int:
    """Choose the number of columns in which to show `count` images, the widest of `width` pixels.

    There are at most six columns, and no more than fit into `_MAX_ROW_WIDTH` at one dot per pixel,
    though never fewer than two unless there is a single image. Of the numbers of columns that need
    equally many rows, the least is returned, so that rows are filled evenly.
    """
    max_columns = min(count, 6, max(2, _MAX_ROW_WIDTH // (width + _GAP)))
    rows = -(-count // max_columns)
    return -(-count // rows)


def new_cells(
    count: int, columns: int, height: int, width: int, *, lines: int = 0, ticks: bool = False
) -> tuple[Figure, Sequence[Axes]]:
    """Make a figure with `count` axes, row by row, each for an image of `height` x `width` pixels.

    - `columns`: number of axes in a row.
    - `lines`: number of lines of the title above each image.
    - `ticks`: whether to reserve space for numbered axes.

    Returns the figure and its axes. Small images are enlarged by an integer factor, up to the
    limits of this file. Larger images are shrunk to the limits. In a single column, however, images
    whose sides are at most `_MAX_ROW_WIDTH` (960) pixels are not shrunk.
    """
    pyplot = import_pyplot()
    rows = -(-count // columns)
    max_scale = min(_MAX_ROW_WIDTH / (columns * width), _MAX_HEIGHT / height)
    if max_scale >= 1:
        scale = float(int(max_scale))
    else:
        # In a single column, images that exceed only the height, up to the limit of width, keep one
        # dot per pixel; others shrink.
        scale = 1.0 if columns == 1 and max(height, width) <= _MAX_ROW_WIDTH else max_scale
    cell_height, cell_width = height * scale, width * scale
    beside = _TICKS if ticks else _GAP
    above = lines * _LINE_HEIGHT + _GAP
    figure_width = columns * (cell_width + beside) + _GAP
    figure_height = rows * (cell_height + above + (_TICKS if ticks else 0)) + _GAP
    dpi = pyplot.rcParams["figure.dpi"]
    figure = pyplot.figure(figsize=(figure_width / dpi, figure_height / dpi), layout="none")
    all_axes = []
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
        all_axes.append(figure.add_axes(box))
    return figure, all_axes
