"""Mip pyramids: every level of every texture in one array, with a table of where each begins.

Level 0, the base level, is the image itself. Each further level halves height and width.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from ..color import premultiply, srgb_to_linear
from ..display.pyramid_text import pyramid_text
from ..names import TextureAddressing, TextureBorder, check_name
from ..numerics.byte_colors import refuse_integer_bytes, warn_of_bytes
from ..numerics.device import to_device, to_host


class TexturePyramid(eqx.Module):
    """Textures and their box-filtered halvings, down to one texel.

    - `texels`: RGB or premultiplied RGBA, texture after texture, level after level, row after row.
    - `levels`: for each texture and level, the index of its first texel, its height and its width
      in texels. A texture with fewer levels than others repeats its last level.
    - `border`: beyond 0..1, `"clamp"` repeats the border texel and `"repeat"` tiles the texture.
    - `addressing`: `"half_texel"` puts texel i of the n along an axis at (i + 0.5) / n, and
      `"corners"` puts it at i / (n - 1).
    """

    texels: Float[Array, "texels channels"]
    levels: Int[Array, "textures levels 3"]
    border: TextureBorder = eqx.field(static=True, default="clamp")
    addressing: TextureAddressing = eqx.field(static=True, default="half_texel")

    def __repr__(self) -> str:
        return pyramid_text(self)

    @property
    def count(self) -> int:
        """Number of textures."""
        return self.levels.shape[-3]

    @property
    def depth(self) -> int:
        """Number of mip levels of the texture that has most."""
        return self.levels.shape[-2]

    @property
    def channels(self) -> int:
        """Number of channels: three, or four if any texture has alpha."""
        return self.texels.shape[-1]

    @staticmethod
    def build(
        images: Sequence[Any],
        border: TextureBorder = "clamp",
        addressing: TextureAddressing = "half_texel",
        linear: bool = False,
    ) -> "TexturePyramid":
        """Build the pyramids of `images`, each `[height, width, 3 or 4]` in 0..1, of any sizes.

        Alpha is straight in the images. Texels are premultiplied by it before averaging, so that
        transparent texels do not bleed colour into their neighbours.

        `linear=True` means that the images are sRGB and the texels shall be linear: colour channels
        are decoded once, before the levels are averaged. If some images have alpha, images of three
        channels get alpha 1. Booleans, integers and half-precision floats become float32. The
        result is differentiable in the images. `border` and `addressing` are fields of the pyramid.

        Raises `ValueError` for an image of another shape, without texels or of integers above 1
        (under a trace, of any unsigned integers), for no images, and for an unknown `border` or
        `addressing`. Warns of images that look like bytes (0..255).
        """
        check_name("border", border, TextureBorder)
        check_name("addressing", addressing, TextureAddressing)
        bases = [_image(image, index) for index, image in enumerate(images)]
        if not bases:
            raise ValueError("`images` must hold at least one texture; got none.")
        channels = max(base.shape[-1] for base in bases)
        chains = [
            _chain(_with_channels(_decode(base) if linear else base, channels)) for base in bases
        ]
        depth = max(map(len, chains))
        table, flat, offset = [], [], 0
        for chain in chains:
            rows = []
            for level in chain:
                height, width = level.shape[:2]
                rows.append((offset, height, width))
                flat.append(level.reshape(-1, channels))
                offset += height * width
            table.append(rows + rows[-1:] * (depth - len(rows)))
        traced = any(isinstance(level, Tracer) for level in flat)
        texels = (jnp if traced else np).concatenate(flat)
        warn_of_bytes({f"texture {index}": base for index, base in enumerate(bases)})
        return TexturePyramid(
            to_device(texels), to_device(np.asarray(table, np.int32)), border, addressing
        )


def _image(image: Any, index: int) -> Any:
    """Check an image and convert it to float32 or float64; `index` is its number in errors.

    Concrete images stay in NumPy, where nothing is compiled. Raises `ValueError` as
    `TexturePyramid.build` does.
    """
    image = to_host(image)
    if image.ndim != 3 or image.shape[-1] not in (3, 4) or 0 in image.shape:
        raise ValueError(
            f"texture {index} must be [height, width, 3 or 4], not empty; got {image.shape}."
        )
    if not jnp.issubdtype(image.dtype, jnp.floating):
        if image.dtype.kind not in "biu":
            raise ValueError(f"texture {index} must hold floats in 0..1; got {image.dtype}.")
        refuse_integer_bytes(f"texture {index}", image)
        return image.astype(np.float32)
    # Half precision is not enough for the averages of the levels.
    return image if image.dtype in (np.float32, np.float64) else image.astype(np.float32)


def _decode(image: Any) -> Any:
    """Convert the colours of an image from sRGB to linear light; alpha stays unchanged."""
    xp = image.__array_namespace__()
    return xp.concat([srgb_to_linear(image[..., :3]), image[..., 3:]], axis=-1)


def _with_channels(image: Any, channels: int) -> Any:
    """Premultiply an image of straight colours, and give it `channels` channels.

    If alpha is missing, an alpha of 1 is appended.
    """
    if image.shape[-1] == channels or image.shape[-1] == 4:
        return premultiply(image)
    xp = image.__array_namespace__()
    return xp.concat([image, xp.ones((*image.shape[:2], 1), dtype=image.dtype)], axis=-1)


def _chain(base: Any) -> list[Any]:
    """List the mip levels of an image: the image itself, then its halvings down to one texel.

    Each level is an array `[height, width, channels]`.
    """
    chain = [base]
    while max(chain[-1].shape[:2]) > 1:
        chain.append(_halve(_halve(chain[-1], 0), 1))
    return chain


def _halve(image: Any, axis: int) -> Any:
    """Halve an axis with a box filter, rounding its size down; the mean is always preserved.

    An axis of one texel stays as it is. A longer odd axis, of 2m + 1 texels, gives m texels, each
    the average over (2m + 1) / m texels: texel i takes 2i, 2i + 1, 2i + 2 with weights
    (m - i, m, i + 1) / (2m + 1).

    **Source:** Guthe and Heckbert, *Non-power-of-two mipmap creation* (NVIDIA, 2005).
    """
    xp = image.__array_namespace__()
    size = image.shape[axis]
    if size == 1:
        return image
    image = xp.moveaxis(image, axis, 0)
    half = size // 2
    if size % 2 == 0:
        small = (image[0::2] + image[1::2]) * 0.5
    else:
        i = np.arange(half, dtype=image.dtype).reshape(-1, 1, 1)
        first, second, third = image[0:-1:2], image[1::2], image[2::2]
        small = ((half - i) * first + half * second + (i + 1) * third) / size
    return xp.moveaxis(small, 0, axis)
