"""The loss of a fit: how far an image is from its target.

To add a loss, write its function here, and put its name into `names.Loss` and into `_LOSSES`. Three
texts describe each loss: the docstrings of `Loss` and of `fit`, and the help of `--loss` in
`cli.fit_options`.

**Source:** Zhao, Gallo, Frosio and Kautz, *Loss Functions for Image Restoration with Neural
Networks* (IEEE TCI 3(1), 2017), for squared or absolute error beside SSIM.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..color import srgb_to_linear
from ..comparison.similarity import ssim
from ..names import Loss as LossKind
from ..names import LossSpace

LossFunction = Callable[[Array, Array], Array]
"""The type of a user's loss: a function of an image and the target that returns a scalar.

`Loss.prepare` has converted the image and the target before the function gets them."""

_SSIM_SHARE = 0.02
"""Weight of 1 - SSIM in the loss `"ssim"`, for each channel of each pixel.

The squared error of one channel of one pixel has the weight 1."""


class Loss(eqx.Module):
    """The error that a fit minimises, summed over the pixels and channels of an image.

    - `kind`: `"squared"`; `"l1"`, absolute error, with gradient 0 where images are equal; or
      `"ssim"`, squared error plus 0.02 (1 - SSIM) for each channel of each pixel.
    - `light`: the colour space. `"display"` compares sRGB values; `"linear"` converts them to
      linear light first, so that errors in dark regions count less.
    - `function`: a loss that the user gave, which replaces `kind`; None if there is none. Arrays
      that it contains, such as those of an `eqx.Module`, are arguments of the compiled program.

    Images with four channels have straight alpha. They are compared premultiplied, with alpha as a
    fourth channel.
    """

    kind: LossKind = eqx.field(static=True, default="squared")
    light: LossSpace = eqx.field(static=True, default="display")
    function: LossFunction | None = None

    @property
    def is_squared(self) -> bool:
        """Whether the loss is squared error, weighted or not, which least-squares solvers need."""
        return self.kind == "squared" and self.function is None

    @property
    def name(self) -> str:
        """The name of the loss, for messages; a user's function is called "a function"."""
        return self.kind if self.function is None else "a function"

    def prepare(self, image: Float[Array, "height width channels"]) -> Array:
        """Convert an sRGB image with straight alpha to the colour space `light`; premultiply it.

        Alpha itself stays the same. An image of three channels has no alpha and is not multiplied.
        """
        color = image[..., :3]
        if self.light == "linear":
            color = srgb_to_linear(color)
        if image.shape[-1] == 3:
            return color
        alpha = image[..., 3:]
        return jnp.concatenate([color * alpha, alpha], -1)

    def residual(
        self,
        image: Float[Array, "height width channels"],
        prepared: Float[Array, "height width channels"],
        weights: Float[Array, "height width"] | None,
    ) -> Array:
        """Compare an image to the target.

        The result for squared error is an array with one residual for each channel of each pixel,
        whose squares sum to the loss. For the other losses, and for a user's function, it is the
        loss, a scalar.

        - `image`: sRGB values, with straight alpha if there are four channels.
        - `prepared`: the target, as `prepare` returns it.
        - `weights`: factors for the squared or absolute error of each pixel; None: all are 1. They
          do not affect SSIM or a user's function.
        """
        if self.function is not None:
            return _scalar(self.function(self.prepare(image), prepared))
        return _LOSSES[self.kind](self.prepare(image), prepared, weights)


def _scalar(value: Any) -> Float[Array, ""]:
    """Convert the result of a user's loss to float32.

    Raises `ValueError` unless it is one floating-point number, a scalar.
    """
    if jnp.shape(value) != () or not jnp.issubdtype(jnp.result_type(value), jnp.floating):
        got = f"{jnp.result_type(value)} {list(jnp.shape(value))}"
        raise ValueError(f"`loss` must return one real number; its function returned {got}.")
    return jnp.asarray(value, jnp.float32)


def _squared(image: Array, target: Array, weights: Array | None) -> Array:
    """Residual of squared error: image minus target, times the square root of the pixel's weight.

    `image`, `target`: as `Loss.prepare` returns them.
    """
    error = image - target
    return error if weights is None else error * jnp.sqrt(weights)[..., None]


def _absolute(image: Array, target: Array, weights: Array | None) -> Float[Array, ""]:
    """Sum of the weighted absolute errors over pixels and channels.

    `image`, `target`: as `Loss.prepare` returns them.
    """
    error = jnp.abs(image - target)
    return jnp.sum(error if weights is None else error * weights[..., None])


def _with_ssim(image: Array, target: Array, weights: Array | None) -> Float[Array, ""]:
    """Sum of the weighted squared errors over pixels and channels, plus a multiple of 1 - SSIM.

    The multiple is `_SSIM_SHARE` times the number of pixels times the number of channels. `image`,
    `target`: as `Loss.prepare` returns them.
    """
    error = _squared(image, target, weights)
    return jnp.sum(error * error) + _SSIM_SHARE * error.size * (1.0 - ssim(image, target))


_LOSSES: dict[LossKind, Callable[[Array, Array, Array | None], Array]] = {
    "squared": _squared,
    "l1": _absolute,
    "ssim": _with_ssim,
}
"""For each value of `Loss.kind`, a function of the image, the target and the weights of the pixels.

`Loss.prepare` has converted the image and the target. The function of `"squared"` returns one
residual for each channel of each pixel; the others return the loss, a scalar."""
