"""What a fit lowers: how far an image is from its target.

**Source:** Zhao, Gallo, Frosio and Kautz, *Loss Functions for Image Restoration with Neural
Networks* (IEEE TCI 3(1), 2017), for squared or absolute error beside SSIM.
"""

from typing import Literal

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .score import ssim

Kind = Literal["squared", "l1", "ssim"]
Light = Literal["display", "linear"]

_SSIM_SHARE = 0.02
"""Squared error that weighs as much as SSIM at 0, for each channel of each pixel."""


class Loss(eqx.Module):
    """The error of an image, in sum over pixels and channels.

    - `kind`: `"squared"` error, `"l1"` (absolute; slope 0 where equal), or `"ssim"`: squared error
      and 0.02 (1 - SSIM) for each value.
    - `light`: images are compared as they are shown, or in `"linear"` light: decoded from sRGB,
      which makes errors in the dark count less.

    Images of four channels have straight alpha and are compared premultiplied, alpha as a fourth
    colour.
    """

    kind: Kind = eqx.field(static=True, default="squared")
    light: Light = eqx.field(static=True, default="display")

    def prepare(self, image: Float[Array, "height width channels"]) -> Array:
        """What is compared: in the light chosen, premultiplied."""
        color = image[..., :3]
        if self.light == "linear":
            color = _to_linear(color)
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
        """A residual whose squares sum to the loss; of other kinds than squared error the loss.

        `prepared` is the target; `weights` scale the error of each pixel, but not SSIM.
        """
        own = self.prepare(image)
        off = own - prepared
        if self.kind == "l1":
            size = jnp.abs(off)
            return jnp.sum(size if weights is None else size * weights[..., None])
        off = off if weights is None else off * jnp.sqrt(weights)[..., None]
        if self.kind == "squared":
            return off
        return jnp.sum(off * off) + _SSIM_SHARE * off.size * (1.0 - ssim(own, prepared))


def _to_linear(values: Array) -> Array:
    """sRGB decoded (IEC 61966-2-1); beyond 0..1 its ends go on straight."""
    inside = jnp.maximum(values, 0.04045)
    curve = ((inside + 0.055) / 1.055) ** 2.4
    return jnp.where(values <= 0.04045, values / 12.92, curve)
