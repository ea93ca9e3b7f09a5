"""The bytes of a picture are those that an image file would hold."""

import jax.numpy as jnp
import numpy as np
import pytest

from softras2d.io.pixel_values import to_bytes
from softras2d.viewing.draw import to_rgba


def floats_near_thresholds() -> np.ndarray:
    """All float32 within 60 roundings of a value at which the byte changes, `[255 * 121]`."""
    thresholds = ((np.arange(255) + 0.5) / 255).astype(np.float32)
    return (thresholds.view(np.int32)[:, None] + np.arange(-60, 61, dtype=np.int32)).view(
        np.float32
    )


@pytest.mark.parametrize("channels", [3, 4])
def test_bytes_are_those_of_a_file(channels):
    rng = np.random.default_rng(0)
    near = floats_near_thresholds().reshape(-1)
    values = np.concatenate([near, [-1, 0, 1, 2], rng.random(1000)]).astype(np.float32)
    image = np.stack([rng.permutation(values) for _ in range(channels)], axis=-1)[None]
    rgba = to_rgba(jnp.asarray(image))
    np.testing.assert_array_equal(rgba[..., :channels], to_bytes(image))
    if channels == 3:
        assert np.all(rgba[..., 3] == 255)


def test_one_rounding_gives_the_same_bytes_as_two():
    near = floats_near_thresholds()
    # The product and the sum are exact in float64.
    once = (near.astype(np.float64) * 255 + 0.5).astype(np.float32)
    np.testing.assert_array_equal(np.floor(once), to_bytes(near))
