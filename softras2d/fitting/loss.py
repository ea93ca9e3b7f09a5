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
"""A loss that a user gives: a scalar from an image and the target, as the solvers see them."""

_SSIM_SHARE = 0.02
"""Weight of 1 - SSIM relative to the squared error, for each channel of each pixel."""


class Loss(eqx.Module):
    """The error of an image, summed over pixels and channels.

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
        """Whether this is squared error, as solvers of least squares need it."""
        return self.kind == "squared" and self.function is None

    @property
    def name(self) -> str:
        """The name of the loss, for messages."""
        return self.kind if self.function is None else "a function"

    def prepare(self, image: Float[Array, "height width channels"]) -> Array:
        """Convert an image to the chosen colour space, and premultiply it."""
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
        """The residual, whose squares sum to the loss; or the scalar loss for `"l1"` and `"ssim"`.

        - `prepared`: the target as `prepare` gives it.
        - `weights`: scale the error of each pixel, but not SSIM.
        """
        if self.function is not None:
            return _scalar(self.function(self.prepare(image), prepared))
        return _LOSSES[self.kind](self.prepare(image), prepared, weights)


def _scalar(value: Any) -> Float[Array, ""]:
    """The value of a user's loss; raise `ValueError` unless it is a real number."""
    if jnp.shape(value) != () or not jnp.issubdtype(jnp.result_type(value), jnp.floating):
        got = f"{jnp.result_type(value)} {list(jnp.shape(value))}"
        raise ValueError(f"`loss` must return one real number; its function returned {got}.")
    return jnp.asarray(value, jnp.float32)


def _squared(image: Array, target: Array, weights: Array | None) -> Array:
    """The weighted residual of squared error, for solvers of least squares too."""
    error = image - target
    return error if weights is None else error * jnp.sqrt(weights)[..., None]


def _absolute(image: Array, target: Array, weights: Array | None) -> Float[Array, ""]:
    """The sum of absolute errors."""
    error = jnp.abs(image - target)
    return jnp.sum(error if weights is None else error * weights[..., None])


def _with_ssim(image: Array, target: Array, weights: Array | None) -> Float[Array, ""]:
    """Squared error, and a share of 1 - SSIM for each channel of each pixel."""
    error = _squared(image, target, weights)
    return jnp.sum(error * error) + _SSIM_SHARE * error.size * (1.0 - ssim(image, target))


_LOSSES: dict[LossKind, Callable[[Array, Array, Array | None], Array]] = {
    "squared": _squared,
    "l1": _absolute,
    "ssim": _with_ssim,
}
"""For each name, the function of image, target and weights; all but `"squared"` give a scalar."""
