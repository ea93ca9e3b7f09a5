"""Plots images, scenes and fits with matplotlib: `pip install "softras2d[plot]"`.

Conventions of all functions:

- An image is an array of floats `[height, width, channels]`, in sRGB, 0..1; values outside are
  clipped when they are shown. One channel is grey; three are RGB; four are RGB with straight alpha,
  shown over a light checkerboard in figures.
- Coordinates are in pixels of the image, x right and y down. Pixel (row r, column c) is the square
  [c, c+1) x [r, r+1).
- `axes` (or `figure`) is the matplotlib object to draw into; by default, a new pyplot figure is
  made (`triangles` and `arrows` always need axes). Functions that plot return the `Axes`, or the
  `Figure` if they may draw several. In a notebook, end the last line of a cell with `;`, so that
  this value is not printed beside the plot.

matplotlib is imported when a function first plots; `ImportError`, one line, says if it is missing.
"""

from .comparison import difference, error
from .curves import convergence
from .overlay import arrows, triangles
from .palette import id_colors
from .picture import show
from .slider import explore
from .strip import animate, film_strip, pyramid
from .visibility import buffers

__all__ = [
    "animate",
    "arrows",
    "buffers",
    "convergence",
    "difference",
    "error",
    "explore",
    "film_strip",
    "id_colors",
    "pyramid",
    "show",
    "triangles",
]
