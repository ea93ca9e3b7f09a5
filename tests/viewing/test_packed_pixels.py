"""Packing and unpacking a picture gives the same pixels."""

import numpy as np
import pytest

from softras2d.viewing.packed_pixels import BLOCK, pack_pixels

from ..cases.viewing import unpacked


def picture(pixels: int, noise: float) -> np.ndarray:
    """RGBA pixels in stripes of one colour, a share of which is replaced by noise."""
    rng = np.random.default_rng(0)
    stripes = np.repeat(rng.integers(0, 256, (pixels // 50 + 1, 4)), 50, axis=0)[:pixels]
    is_noise = np.arange(pixels) < noise * pixels
    mixed = np.where(is_noise[:, None], rng.integers(0, 256, (pixels, 4)), stripes)
    return mixed.astype(np.uint8).reshape(-1)


@pytest.mark.parametrize("pixels", [BLOCK, 1000, 33 * BLOCK, 33 * BLOCK + 5])
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_unpacking_gives_back_the_pixels(pixels, noise):
    rgba = picture(pixels, noise)
    if pixels == BLOCK:
        rgba[:] = 7
    packed = pack_pixels(rgba)
    assert packed is not None
    header = {"blocks": packed.blocks, "colors": packed.colors}
    assert unpacked(header, packed.payload) == rgba.tobytes()


@pytest.mark.parametrize("pixels", [1, BLOCK - 1, 1000])
def test_what_would_save_little_is_not_packed(pixels):
    assert pack_pixels(picture(pixels, 1.0)) is None


def test_a_flat_picture_is_much_smaller():
    packed = pack_pixels(np.full(4 * 100 * BLOCK, 9, np.uint8))
    assert packed is not None and len(packed.payload) == 16 + 4 * 100
