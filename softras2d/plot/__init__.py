"""Figures of images, scenes and fits, with matplotlib: `pip install "softras2d[plot]"`.

Overlays are in pixels of the image: x right, y down, and pixel (row r, column c) is the square
[c, c+1) x [r, r+1). Images are float `[height, width, channels]` in 0..1: one channel is shown as
grey, four (straight alpha) over a light checkerboard; what lies outside 0..1 is clipped.

With `axes=` (or `figure=`) a function draws there, without it into a new figure of pyplot. It
returns the `Axes`, or the `Figure` where it draws several. In a notebook, end the last line of a
cell with `;`, else its value is printed beside the picture. matplotlib is imported by the first
call; `ImportError`, one line, says so if it is missing.
"""

from .comparison import difference, error
from .curves import convergence
from .overlay import arrows, triangles
from .picture import show
from .slider import explore
from .strip import animate, film_strip, pyramid

__all__ = [
    "animate",
    "arrows",
    "convergence",
    "difference",
    "error",
    "explore",
    "film_strip",
    "pyramid",
    "show",
    "triangles",
]
