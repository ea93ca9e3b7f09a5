"""Defines the view: which part of a drawing is shown, and how large."""

from dataclasses import dataclass

from .message_fields import check_range

MAX_OFFSET = 2**20
"""Maximum size of the offset of a view in the enlarged drawing, in pixels along either axis."""

MAX_CANVAS_SIDE = 8192
"""Maximum length of a side of a view's canvas, in pixels."""

MAX_CANVAS_PIXELS = 2**24
"""Maximum number of pixels of a view's canvas."""

MAX_ENLARGED_SIDE = 2**16
"""Maximum height and width of an enlarged drawing, in pixels.

The spacing of float32 values is at most 1/256 pixel there.
"""


@dataclass(frozen=True)
class View:
    """The part of a drawing that a canvas shows.

    - `zoom`: pixels of the canvas per pixel of the drawing.
    - `x`, `y`: column and row of the pixel at the top left of the canvas, counted in the enlarged
      drawing (the drawing times `zoom`), like the `origin` of a plan. The pixel may lie outside the
      drawing.
    - `height`, `width`: size of the canvas, in pixels.

    Raises `ValueError` for values outside the range that can be drawn.
    """

    zoom: float
    x: int
    y: int
    height: int
    width: int

    def __post_init__(self):
        check_range("zoom", self.zoom, 1e-4, 1e5)
        for name in ("x", "y"):
            check_range(name, getattr(self, name), -MAX_OFFSET, MAX_OFFSET)
        for name in ("height", "width"):
            check_range(name, getattr(self, name), 1, MAX_CANVAS_SIDE)
        check_range("height x width", self.height * self.width, 1, MAX_CANVAS_PIXELS)


def enlarged_size(height: int, width: int, zoom: int | float) -> tuple[int, int]:
    """Height and width, in whole pixels and at least 1, of a drawing that is enlarged by `zoom`.

    `height` and `width` are those of the drawing at zoom 1. Raises `ValueError` for a size at which
    float32 coordinates are too coarse.
    """
    enlarged = max(1, round(height * zoom)), max(1, round(width * zoom))
    if max(enlarged) > MAX_ENLARGED_SIDE:
        raise ValueError(
            f"the drawing would be {enlarged[1]} x {enlarged[0]} pixels; at most "
            f"{MAX_ENLARGED_SIDE} a side."
        )
    return enlarged
