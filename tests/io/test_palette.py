"""Palettes: few colours are exact, many are approximated, and small areas keep their colours."""

import numpy as np
import pytest

from softras2d.io.palette import COLORS, quantized

RNG = np.random.default_rng(3)


@pytest.mark.parametrize("count", [1, 2, 255, 256])
def test_few_colours_are_exact(count):
    # Odd multipliers permute the bytes, so no two colours are equal.
    k = np.arange(count)
    colors = np.stack([k * 7, k * 91, k * 13], axis=1).astype(np.uint8)
    image = colors[RNG.permutation(np.resize(k, 40 * 30))].reshape(40, 30, 3)
    indices, palette = quantized(image)
    assert indices.dtype == np.uint8 and len(palette) == count
    np.testing.assert_array_equal(palette[indices], image)


def test_many_colours_are_near():
    ramp = np.linspace(0, 255, 96)
    image = np.stack(np.broadcast_arrays(ramp[:, None], ramp[None, :], 90.0), axis=-1)
    image = np.rint(image).astype(np.uint8)
    indices, palette = quantized(image)
    assert len(palette) == COLORS
    error = np.abs(palette[indices].astype(float) - image)
    # Boxes of 16 x 16 levels have a mean distance of 4 from the middle in each channel, at most 8.
    assert error[..., :2].mean() < 4.5 and error.max() <= 16
    assert error[..., 2].max() == 0


def test_a_small_area_has_its_colour_beside_many():
    image = np.full((200, 200, 3), 255, np.uint8)
    image[:100, :, 0] = np.arange(200)
    image[:100, :, 1] = np.arange(100)[:, None]
    image[150:153, 20:23] = (200, 0, 0)
    indices, palette = quantized(image)
    shown = palette[indices].astype(int)
    assert np.abs(shown[150:153, 20:23] - [200, 0, 0]).max() <= 1
    assert (shown[160:] == 255).all()
