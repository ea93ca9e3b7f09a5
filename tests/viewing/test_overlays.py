"""Overlays of a view: gradients to an image that has alpha."""

import numpy as np

import softras2d as sr
from softras2d.viewing.draw import Artist
from softras2d.viewing.overlays import position_gradients
from softras2d.viewing.settings import Settings
from softras2d.viewing.view import View


def test_a_translucent_picture_that_equals_its_target_has_no_gradients():
    scene = sr.Scene.from_soup(
        [[[2, 2], [14, 3], [4, 13]]], [[1.0, 0.0, 0.0, 0.2]], background=[0.0, 0.0, 0.0, 0.0]
    )
    view, settings, artist = View(1.0, 0, 0, 16, 16), Settings(samples=1), Artist()
    target = artist.draw(scene, view, settings).rgba
    assert set(target[..., 3].ravel()) == {0, 51}
    same = position_gradients(artist, scene, view, settings, target)
    other = position_gradients(artist, scene, view, settings, np.full_like(target, 255))
    assert len(same) == 3 and np.abs(other[:, 2:]).max() > 1e-3
    np.testing.assert_allclose(same[:, 2:], 0, atol=1e-7)
