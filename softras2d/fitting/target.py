"""The image to be fitted, and the aliases for arrays of pixels on the host."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..color import premultiply

Image = Float[np.ndarray, "height width channels"]
"""An image as a NumPy array, `[height, width, 3 or 4]`, with values in 0..1."""

PixelMap = Float[np.ndarray, "height width"]
"""One number for each pixel of an image, in a NumPy array."""


class Target(NamedTuple):
    """The image that a fit approximates, and how much the error of each of its pixels counts.

    - `image`: values in 0..1 with straight alpha, as `io.read_image` returns them, unless a
      function asks for premultiplied values.
    - `weights`: factors, 0 or more, for the squared or absolute error of each pixel. Their mean is
      1 over the image at its original size. None: all are 1.
    """

    image: Image
    weights: PixelMap | None = None

    def premultiplied(self) -> "Target":
        """Return the target with its colours multiplied by their alpha, and the same weights.

        An image without alpha stays the same.
        """
        return self._replace(image=premultiply(self.image))
