"""How the texels along one axis are mixed around a point: one class for each name of a filter.

A two-dimensional filter is the product of one mix along u and the same mix along v. With negative
weights, colours and alpha may leave the range of the texels.

To add a filter, write its class here, and put its name into `names.PixelFilter` and into
`TEXEL_FILTERS`. Describe the filter at `Filter.pixel` in `options.py`; the command line offers
every name of `PixelFilter`. For plans to report the filter as an effect, add a row to `EFFECTS` and
the effect's name to `SCENE_EFFECTS` (both in `planning.effects`), and leave this effect out in the
tests where one plan has all effects. The viewer offers the filter once its name is in
`PIXEL_FILTERS` of `viewing/static/viewer.js`.
"""

import abc
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..names import PixelFilter


class AbstractTexelFilter(eqx.Module):
    """Interface: weights of the texels around a position on an axis where texel i lies at i.

    For a position, in texels, let `start = floor(position + shift)`. A tap is one of the texels
    that are mixed.

    - `taps`: number of neighbouring texels that are mixed.
    - `first`: index of the first of these texels, minus `start`.
    - `shift`: the shift in `start`, in texels.
    """

    taps: eqx.AbstractClassVar[int]
    first: eqx.AbstractClassVar[int]
    shift: eqx.AbstractClassVar[float]

    @abc.abstractmethod
    def weights(self, fraction: Float[Array, "*points"]) -> tuple[Array, ...]:
        """Compute the weight of each tap, in order; the weights add up to 1.

        `fraction` is `position - start`, in `-shift .. 1 - shift`. It reaches the upper end only if
        `shift` is 0, at the last texel of an axis whose border is clamped. The gradient of the
        filtered texture by the position follows from the derivatives of the weights.
        """


class Nearest(AbstractTexelFilter):
    """The texel whose centre is nearest; of two that are equally near, the right one."""

    taps: ClassVar[int] = 1
    first: ClassVar[int] = 0
    shift: ClassVar[float] = 0.5

    def weights(self, fraction: Float[Array, "*points"]) -> tuple[Array, ...]:
        """Give the one tap the weight 1, whose derivative is zero."""
        return (jnp.ones_like(fraction),)


class Bilinear(AbstractTexelFilter):
    """Linear interpolation between the texels on both sides of the position.

    At a texel's centre, where the mix has a kink, the gradient is the one to the right.
    """

    taps: ClassVar[int] = 2
    first: ClassVar[int] = 0
    shift: ClassVar[float] = 0.0

    def weights(self, fraction: Float[Array, "*points"]) -> tuple[Array, ...]:
        """Compute the weights of the left and the right texel, linear in the position."""
        return 1 - fraction, fraction


TEXEL_FILTERS: dict[PixelFilter, AbstractTexelFilter] = {
    "nearest": Nearest(),
    "bilinear": Bilinear(),
}
"""The filter of each name of `Filter.pixel`."""
