"""The files that `softras2d fit` writes."""

import numpy as np

import softras2d as sr
from softras2d.cli.fit_files import small_images


def test_animations_show_a_transparent_background_as_white():
    half_red = sr.Scene.from_soup(
        [[[0, 0], [40, 0], [0, 40]]], [[1, 0, 0, 0.5]], background=[0.2, 0.4, 0.6, 0.0]
    )
    (image,) = small_images([half_red], 20, 30)
    assert image.shape == (20, 30, 3)
    np.testing.assert_allclose(image[0, 0], [1, 0.5, 0.5], atol=1e-6)
    np.testing.assert_array_equal(image[-1, -1], [1, 1, 1])
