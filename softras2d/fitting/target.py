"""The image to be fitted, and the aliases for arrays of pixels on the host."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..color import premultiply

Image = Float[np.ndarray, "height width channels"]
PixelMap = Float[np.ndarray, "height width"]


class Target(NamedTuple):
    """An image, and how much the error of each of its pixels counts.

    - `image`: values 0..1 with straight alpha, as `io.read_image` gives them, unless a function
      asks for premultiplied ones.
    - `weights`: 0 or more, with a mean of 1 over the original image; None: all pixels count alike.
    """

    image: Image
    weights: PixelMap | None = None

    def premultiplied(self) -> "Target":
        """The target with its colours multiplied by their alpha."""
        return self._replace(image=premultiply(self.image))
