"""The sRGB transfer function keeps black and white, and is exact to a rounding between them."""

import jax.numpy as jnp
import numpy as np
import pytest

from softras2d.color import linear_to_srgb


@pytest.mark.parametrize("xp", [np, jnp])
@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_black_and_white_stay_the_same_in_srgb(xp, dtype):
    values = xp.asarray([-1.0, 0.0, 1.0], dtype=dtype)
    np.testing.assert_array_equal(linear_to_srgb(values), values)


def test_srgb_is_within_a_rounding_of_the_formula():
    values = np.linspace(0.04045 / 12.92, 1.0, 100_001, dtype=np.float32)[1:]
    expected = 1.055 * values.astype(np.float64) ** (1 / 2.4) - 0.055
    np.testing.assert_allclose(linear_to_srgb(values), expected, rtol=0, atol=2**-23)
