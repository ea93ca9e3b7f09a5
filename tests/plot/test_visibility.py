"""`softras2d.plot.buffers` and `id_colors`: what they show of visibility buffers."""

import itertools

import jax.numpy as jnp
import matplotlib
import numpy as np
import pytest

matplotlib.use("Agg")

from matplotlib import pyplot

from softras2d import plot
from softras2d.plot import visibility
from softras2d.plot.palette import BACKGROUND

from ..cases.visibility import visible

CORNERS = np.array([[[1, 1], [14, 2], [3, 9.0]], [[4, 0], [15, 9], [2, 8]]])
VISIBLE = visible(CORNERS, np.array([[1, 1, 1], [0, 2, 2.0]]), height=10, width=16)


@pytest.fixture(autouse=True)
def close_figures():
    yield
    pyplot.close("all")


def panels(figure):
    """The array of the last image in each panel of a figure, by the panel's title."""
    return {axes.get_title(): np.asarray(axes.get_images()[-1].get_array()) for axes in figure.axes}


def test_neighbouring_numbers_have_colours_far_apart():
    colors = plot.id_colors(np.arange(256).reshape(16, 16))
    assert colors.shape == (16, 16, 3)
    flat = colors.reshape(-1, 3)
    for step in range(1, 5):
        assert np.linalg.norm(flat[step:] - flat[:-step], axis=1).min() > 0.2
    # Any two of the first 100 colours differ by an amount that is just visible.
    distances = [np.abs(a - b).max() for a, b in itertools.combinations(flat[:100], 2)]
    assert min(distances) > 0.02
    # No colour is as close to grey as the background.
    assert np.ptp(flat, axis=1).min() > 0.15


def test_a_number_keeps_its_colour_and_samples_are_averaged():
    number = np.array([[[7, 7, -1, 3]]])
    colors = plot.id_colors(np.array([[7, 3, -1]]))[0]
    np.testing.assert_array_equal(colors[2], np.full(3, BACKGROUND, np.float32))
    mean = (2 * colors[0] + colors[1] + colors[2]) / 4
    np.testing.assert_allclose(plot.id_colors(jnp.asarray(number))[0, 0], mean, rtol=1e-6)


@pytest.mark.parametrize("triangle", [np.zeros((2, 2, 1)), np.zeros(2, int), np.zeros((0, 2), int)])
def test_what_is_no_number_of_triangles_is_refused(triangle):
    with pytest.raises(ValueError, match="`triangle` must be integers") as caught:
        plot.id_colors(triangle)
    assert "\n" not in str(caught.value)


def test_every_buffer_has_a_panel():
    shown = panels(plot.buffers(VISIBLE))
    depth_title, overdraw_title = list(shown)[2], list(shown)[4]
    assert list(shown)[:2] == ["triangle", "barycentric weights"]
    assert depth_title.startswith("depth: ") and overdraw_title == "overdraw: 0 to 2"
    np.testing.assert_array_equal(shown["triangle"], plot.id_colors(VISIBLE.triangle))
    np.testing.assert_allclose(shown["coverage"], VISIBLE.coverage)


def test_weights_are_red_green_and_blue_at_the_corners():
    large = visible(np.array([[[0, 0], [32, 0], [0, 32.0]]]), np.ones((1, 3)), height=32, width=32)
    colors = panels(plot.buffers(large))["barycentric weights"]
    for (row, column), corner in zip(((0, 0), (0, 30), (30, 0)), np.eye(3), strict=True):
        np.testing.assert_allclose(colors[row, column], corner, atol=0.1)
    np.testing.assert_allclose(colors[-1, -1], BACKGROUND)


def test_nearer_is_lighter_and_the_background_is_transparent():
    steps = np.array([[[3, 3, 3], [1, 1, 1.0]][k] for k in range(2)])
    apart = np.array([[[0, 0], [8, 0], [0, 8.0]], [[16, 0], [16, 8], [8, 8.0]]])
    shown = panels(plot.buffers(visible(apart, steps, height=8, width=16)))
    depth = shown["depth: 1 (light) to 3"]
    far, near, nothing = depth[1, 1], depth[6, 14], depth[1, 9]
    np.testing.assert_allclose(far, [0.1, 0.1, 0.1, 1], atol=1e-6)
    np.testing.assert_allclose(near, 1)
    assert nothing[3] == 0


def test_depth_and_overdraw_are_optional():
    class Plain:
        triangle, barycentric, depth, coverage = *VISIBLE[:2], None, VISIBLE.coverage

    titles = ["triangle", "barycentric weights", "coverage"]
    assert list(panels(plot.buffers(Plain()))) == titles
    assert list(panels(plot.buffers(VISIBLE._replace(depth=None, overdraw=None)))) == titles


def test_the_nearest_of_several_layers_is_shown():
    hidden = visible(CORNERS[:1], np.full((1, 3), 9.0), height=10, width=16)
    names = ("triangle", "barycentric", "depth")
    layers = VISIBLE._replace(
        **{n: np.stack([getattr(VISIBLE, n), getattr(hidden, n)], axis=3) for n in names}
    )
    assert layers.triangle.shape == (10, 16, 16, 2)
    one_layer = panels(plot.buffers(VISIBLE))
    for title, image in panels(plot.buffers(layers)).items():
        np.testing.assert_array_equal(image, one_layer[title])


def test_an_object_without_the_buffers_is_refused():
    class Layers:
        triangle = barycentric = coverage = np.zeros((2, 2, 1))

    with pytest.raises(ValueError) as caught:
        visibility._check_fields(Layers())
    assert str(caught.value) == (
        "`visible` must be the result of `rasterize`, or have the fields triangle, barycentric, "
        "depth and coverage; got Layers."
    )


def test_buffers_of_the_background_alone_are_shown():
    empty = visible(CORNERS[:0], np.zeros((0, 3)), height=4, width=6, rate=1)
    shown = panels(plot.buffers(empty))
    assert not shown["depth"][..., 3].any()
    np.testing.assert_allclose(shown["triangle"], BACKGROUND)


@pytest.mark.parametrize("name", ["barycentric", "depth", "coverage", "overdraw"])
def test_shapes_that_do_not_fit_are_refused(name):
    with pytest.raises(ValueError, match=f"`{name}` must be \\[10, 16.*got \\[2\\]") as caught:
        plot.buffers(VISIBLE._replace(**{name: np.zeros(2)}))
    assert "\n" not in str(caught.value)


def test_triangles_need_an_axis_of_samples():
    with pytest.raises(ValueError, match="`triangle` must be"):
        plot.buffers(VISIBLE._replace(triangle=VISIBLE.triangle[..., 0]))
