"""The loss of a fit: how far an image is from its target.

**Source:** Zhao, Gallo, Frosio and Kautz, *Loss Functions for Image Restoration with Neural
Networks* (IEEE TCI 3(1), 2017), for squared or absolute error beside SSIM.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..color import srgb_to_linear
from ..names import Loss as LossKind
from ..names import LossSpace
from .score import ssim

_SSIM_SHARE = 0.02
"""Weight of 1 - SSIM, for each channel of each pixel, beside the squared error."""


class Loss(eqx.Module):
    """The error of an image, summed over pixels and channels.

    - `kind`: `"squared"`; `"l1"`, absolute error, with gradient 0 where images are equal; or
      `"ssim"`, squared error plus 0.02 (1 - SSIM) for each channel of each pixel.
    - `light`: `"display"` compares sRGB values; `"linear"` decodes them first, so that errors in
      dark regions count less.

    Images with four channels have straight alpha. They are compared premultiplied, with alpha as a
    fourth channel.
    """

    kind: LossKind = eqx.field(static=True, default="squared")
    light: LossSpace = eqx.field(static=True, default="display")

    def prepare(self, image: Float[Array, "height width channels"]) -> Array:
        """The image as it is compared: in the chosen light, premultiplied."""
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
        """The residual, whose squares sum to the loss; for `"l1"` and `"ssim"` the scalar loss.

        - `prepared`: the target as `prepare` gives it.
        - `weights`: scale the error of each pixel, but not SSIM.
        """
        compared = self.prepare(image)
        off = compared - prepared
        if self.kind == "l1":
            size = jnp.abs(off)
            return jnp.sum(size if weights is None else size * weights[..., None])
        off = off if weights is None else off * jnp.sqrt(weights)[..., None]
        if self.kind == "squared":
            return off
        return jnp.sum(off * off) + _SSIM_SHARE * off.size * (1.0 - ssim(compared, prepared))
