"""Notebooks show scenes, fits and visibility buffers as pictures."""

import base64
import html
import re
import subprocess
import sys
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d.display import scene_picture
from softras2d.display.notebook import buffers_html, image_html
from softras2d.io.images import decode_image

from ..cases.visibility import visible

# Tests share a few scenes of one size class, because each further program takes seconds to compile.
SQUARE = np.array([[[0, 0], [40, 0], [40, 20]], [[0, 0], [40, 20], [0, 20]]], np.float32)
COLORS = np.array([[1, 0, 0], [0, 0, 1]], np.float32)
SCENE = sr.Scene.from_soup(SQUARE, COLORS)


def picture_of(text):
    """The image `[height, width, channels]` in the HTML that a value returns for notebooks."""
    (data,) = re.findall(r'src="data:image/png;base64,([^"]*)"', text)
    return decode_image(base64.b64decode(data), "picture")


@pytest.mark.slow
def test_a_scene_shows_itself_above_its_text():
    shown = SCENE._repr_html_()
    assert shown is not None
    picture = picture_of(shown)
    assert picture.shape == (160 + 32, 320, 3)
    # These pixels are in the lower left half, in the upper right half, and in the margin.
    np.testing.assert_array_equal(picture[150, 40], [0, 0, 1])
    np.testing.assert_array_equal(picture[40, 280], [1, 0, 0])
    np.testing.assert_array_equal(picture[[0, -1, 96, 96], [160, 160, 0, -1]], 1)
    assert html.escape(repr(SCENE)) in shown


def test_offset_and_unit_of_a_scene_do_not_matter():
    picture = picture_of(SCENE._repr_html_())
    for scale, offset in ((2.0**-20, 0.0), (2.0**10, 2.0**16)):
        moved = replace(SCENE, positions=SCENE.positions * scale + offset)
        np.testing.assert_array_equal(picture_of(moved._repr_html_()), picture)


def test_invalid_batched_and_empty_scenes_are_text_only():
    for scene in (
        replace(SCENE, positions=SCENE.positions * np.nan),
        replace(SCENE, colors=SCENE.colors * np.nan),
        replace(SCENE, positions=SCENE.positions * 0),
        replace(SCENE, triangles=SCENE.triangles + 4),
        jax.tree.map(lambda leaf: np.stack([leaf, leaf]), SCENE),
        jax.eval_shape(lambda: SCENE),
        sr.Scene.from_soup([], []),
    ):
        assert scene._repr_html_() is None


def test_numbers_near_the_limits_of_float32_are_drawn_or_left():
    for scale in (1e37, 1e-37, 1e-44):
        scene = replace(SCENE, positions=SCENE.positions * np.float32(scale))
        shown = scene._repr_html_()
        assert shown is None or picture_of(shown).shape == (192, 320, 3)


def test_scenes_that_would_take_long_are_not_drawn(monkeypatch):
    def refuse(*arguments, **options):
        raise AssertionError("drawn")

    monkeypatch.setattr(sr, "render", refuse)
    with monkeypatch.context() as limits:
        limits.setattr(scene_picture, "_MAX_TRIANGLES", 1)
        assert SCENE._repr_html_() is None
    # Layers of translucent triangles that each cover half of the picture.
    many = np.tile(SQUARE[:1], (2**15, 1, 1))
    assert sr.Scene.from_soup(many, np.full((2**15, 4), 0.5))._repr_html_() is None


def test_a_fit_shows_its_image_and_scores():
    image = np.random.default_rng(0).integers(0, 256, (20, 30, 3)).astype(np.float32) / 255
    result = sr.FitResult(SCENE, image, 27.314, 0.81, (), {})
    shown = result._repr_html_()
    assert shown is not None
    np.testing.assert_array_equal(picture_of(shown), image)
    assert "PSNR 27.31 dB" in shown


def test_large_images_are_shrunk_to_means_of_blocks():
    image = np.zeros((7, 1300, 4), np.float32)
    image[:, ::3, 0], image[:, ::3, 3] = 1, 0.5
    shown = image_html(image, "text")
    assert shown is not None
    picture = picture_of(shown)
    # Blocks have 3 x 3 pixels, and fewer in the last row and column.
    assert picture.shape == (3, 434, 4)
    np.testing.assert_allclose(picture[..., :3], np.broadcast_to([1, 0, 0], (3, 434, 3)))
    np.testing.assert_allclose(picture[:, :-1, 3], 1 / 6, atol=1 / 255)
    np.testing.assert_allclose(picture[:, -1, 3], 1 / 2, atol=1 / 255)
    assert "conic-gradient" in shown


@pytest.mark.parametrize("image", [np.full((2, 2, 3), np.nan), np.zeros((0, 2, 3)), None, "text"])
def test_what_is_no_image_is_text_only(image):
    assert image_html(image, "text") is None


def test_texts_are_escaped():
    shown = image_html(np.zeros((2, 2, 3)), 'a <b> "c"\nd')
    assert shown is not None
    assert "<b>" not in shown
    assert 'alt="a &lt;b&gt; &quot;c&quot;"' in shown


def test_an_image_is_shown_above_an_empty_text():
    shown = image_html(np.zeros((2, 2, 3)), "")
    assert shown is not None
    assert picture_of(shown).shape == (2, 2, 3) and 'alt=""' in shown


def test_buffers_show_the_numbers_of_triangles():
    buffers = visible(SQUARE.astype(float), np.ones((2, 3)), height=30, width=50)
    shown = buffers_html(buffers, "buffers")
    assert shown is not None
    expected = sr.plot.id_colors(buffers.triangle)
    np.testing.assert_allclose(picture_of(shown), expected, atol=0.5 / 255 + 1e-6)


def test_visibility_shows_itself_above_its_text():
    triangle = np.full((20, 40, 4), -1, np.int32)
    triangle[:, 20:] = 1
    plan = sr.plan(SCENE, height=20, width=40, coverage=sr.Hard(samples=4))
    buffers = sr.Visibility(jnp.asarray(triangle), SCENE, plan, jnp.array(False))
    shown = buffers._repr_html_()
    assert shown is not None
    expected = sr.plot.id_colors(triangle)
    np.testing.assert_allclose(picture_of(shown), expected, atol=0.5 / 255 + 1e-6)
    assert html.escape(repr(buffers)) in shown
    with_layers = replace(buffers, triangle=buffers.triangle[..., None])
    assert with_layers._repr_html_() is None


def test_ipython_shows_pictures_and_texts():
    formatters = pytest.importorskip("IPython.core.formatters")
    data, _ = formatters.DisplayFormatter().format(SCENE)
    assert data["text/plain"] == repr(SCENE)
    assert picture_of(data["text/html"]).shape == (192, 320, 3)


def test_a_notebook_needs_no_matplotlib():
    script = """
import sys
import numpy as np
from softras2d.display.notebook import buffers_html, image_html
class Buffers:
    triangle = np.zeros((2, 2, 1), np.int32)
assert buffers_html(Buffers, "buffers")
assert image_html(np.zeros((2, 2, 3)), "image")
print("matplotlib" in sys.modules)
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.strip() == "False"
