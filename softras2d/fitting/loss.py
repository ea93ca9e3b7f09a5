"""The loss of a fit: how far an image is from its target.

To add a loss, write its function here, and put its name into `names.Loss` and into `_LOSSES`.

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
"""A user's loss: a function of an image and the target that returns a scalar.

Both are as `Loss.prepare` returns them."""

_SSIM_SHARE = 0.02
"""Weight of 1 - SSIM in the loss `"ssim"`, for each channel of each pixel.

The squared error of a channel of a pixel has the weight 1."""


class Loss(eqx.Module):
    """The error that a fit minimises, summed over the pixels and channels of an image.

    - `kind`: `"squared"`; `"l1"`, absolute error, with gradient 0 where images are equal; or
      `"ssim"`, squared error plus 0.02 (1 - SSIM) for each channel of each pixel.
    - `light`: the colour space. `"display"` compares sRGB values; `"linear"` decodes them first, so
      that errors in dark regions count less.
    - `function`: a loss that the user gave, in place of `kind`; None: there is none. Arrays that it
      holds, such as those of an `eqx.Module`, are arguments of the compiled program.

    Images with four channels have straight alpha. They are compared premultiplied, with alpha as a
    fourth channel.
    """

    kind: LossKind = eqx.field(static=True, default="squared")
    light: LossSpace = eqx.field(static=True, default="display")
    function: LossFunction | None = None

    @property
    def is_squared(self) -> bool:
        """Whether the loss is squared error, which least-squares solvers need."""
        return self.kind == "squared" and self.function is None

    @property
    def name(self) -> str:
        """The name of the loss, for messages."""
        return self.kind if self.function is None else "a function"

    def prepare(self, image: Float[Array, "height width channels"]) -> Array:
        """Convert an sRGB image with straight alpha to the colour space `light`; premultiply it."""
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

        Squared error returns a residual for each channel of each pixel, whose squares sum to the
        loss. The other losses, and a user's function, return the loss, a scalar.

        - `image`: sRGB values, with straight alpha if there are four channels.
        - `prepared`: the target as `prepare` returns it.
        - `weights`: factors for the squared or absolute error of each pixel; None: all are 1. They
          do not affect SSIM or a user's function.
        """
        if self.function is not None:
            return _scalar(self.function(self.prepare(image), prepared))
        return _LOSSES[self.kind](self.prepare(image), prepared, weights)


def _scalar(value: Any) -> Float[Array, ""]:
    """Convert what a user's loss returned to float32; raise `ValueError` unless it is a scalar."""
    if jnp.shape(value) != () or not jnp.issubdtype(jnp.result_type(value), jnp.floating):
        got = f"{jnp.result_type(value)} {list(jnp.shape(value))}"
        raise ValueError(f"`loss` must return one real number; its function returned {got}.")
    return jnp.asarray(value, jnp.float32)


def _squared(image: Array, target: Array, weights: Array | None) -> Array:
    """Residual of squared error: the difference of the images times the root of the weights."""
    error = image - target
    return error if weights is None else error * jnp.sqrt(weights)[..., None]


def _absolute(image: Array, target: Array, weights: Array | None) -> Float[Array, ""]:
    """Sum of the weighted absolute errors over pixels and channels."""
    error = jnp.abs(image - target)
    return jnp.sum(error if weights is None else error * weights[..., None])


def _with_ssim(image: Array, target: Array, weights: Array | None) -> Float[Array, ""]:
    """Sum of the weighted squared errors over pixels and channels, plus a multiple of 1 - SSIM.

    The multiple is `_SSIM_SHARE` for each channel of each pixel.
    """
    error = _squared(image, target, weights)
    return jnp.sum(error * error) + _SSIM_SHARE * error.size * (1.0 - ssim(image, target))


_LOSSES: dict[LossKind, Callable[[Array, Array, Array | None], Array]] = {
    "squared": _squared,
    "l1": _absolute,
    "ssim": _with_ssim,
}
"""For each value of `Loss.kind`, the function of the prepared image, target and weights.

The function of `"squared"` returns a residual; the others return the loss, a scalar."""
