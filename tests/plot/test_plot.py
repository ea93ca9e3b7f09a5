"""`softras2d.plot`: what each function draws, and one-line errors for what it cannot draw."""

# pyright: reportOptionalMemberAccess=false, reportAttributeAccessIssue=false
# pyright: reportIndexIssue=false, reportArgumentType=false, reportCallIssue=false
# pyright: reportOperatorIssue=false, reportOptionalOperand=false

import subprocess
import sys

import jax
import matplotlib
import numpy as np
import pytest

matplotlib.use("Agg")

from matplotlib import pyplot
from PIL import Image, ImageSequence

import softras2d as sr
from softras2d import plot
from softras2d.fitting.result import Record
from softras2d.plot.picture import INSET
from softras2d.plot.slider import slider

RNG = np.random.default_rng(0)
IMAGE = RNG.random((20, 30, 3)).astype(np.float32)
SCENE = sr.Scene.from_mesh(
    np.array([[2, 3], [25, 4], [8, 17], [28, 18.0]]),
    [[0, 1, 2], [1, 3, 2]],
    triangle_colors=np.ones((2, 3)),
)


@pytest.fixture(autouse=True)
def close_figures():
    yield
    pyplot.close("all")


def drawn(figure):
    """The pixels of a Matplotlib figure, `[height, width, 4]` bytes."""
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba())


class TestShow:
    def test_pixels_are_squares_of_the_axes(self):
        axes = plot.show(IMAGE, title="noise")
        (picture,) = axes.get_images()
        np.testing.assert_array_equal(picture.get_array(), IMAGE)
        assert tuple(picture.get_extent()) == (0, 30, 20, 0)
        assert axes.get_title() == "noise"
        assert axes.get_ylim() == (20, 0)

    def test_a_pixel_is_a_whole_number_of_dots(self):
        steps = (np.indices((6, 9)).sum(0) % 2)[..., None].astype(float)
        shot = drawn(plot.show(steps).figure)[..., 0]
        row = shot[shot.shape[0] // 2]
        widths = np.diff(np.flatnonzero(np.diff(row.astype(int))))
        # The frame of the plot covers a part of the pixels at both ends.
        inner = widths[widths > 2][1:-1]
        assert len(set(inner.tolist())) == 1

    def test_images_of_one_and_four_channels_are_shown(self):
        grey = plot.show(IMAGE[..., :1]).get_images()[0]
        assert grey.get_array().shape == (20, 30)
        assert (grey.norm.vmin, grey.norm.vmax) == (0, 1)
        clear = np.concatenate([IMAGE, np.full((20, 30, 1), 0.5, np.float32)], -1)
        assert len(plot.show(clear).get_images()) == 2

    @pytest.mark.parametrize(("side", "lines"), [(64, 65), (65, 33)])
    def test_a_grid_has_lines_between_pixels(self, side, lines):
        axes = plot.show(np.zeros((3, side, 3)), grid=True)
        (drawn_lines,) = axes.collections
        upright = [line for line in drawn_lines.get_segments() if line[0, 0] == line[1, 0]]
        assert len(upright) == lines
        assert axes.get_xlabel() == "x (pixels)"

    def test_an_inset_has_a_grid_of_its_own(self):
        axes = plot.show(np.zeros((200, 200, 3)), grid=True, inset=(7, 11, 5, 3))
        (grid,) = axes.child_axes[0].collections
        ends = np.concatenate(grid.get_segments())
        assert len(grid.get_segments()) == (5 + 1) + (3 + 1)
        np.testing.assert_array_equal(ends.min(axis=0), [11, 7])
        np.testing.assert_array_equal(ends.max(axis=0), [14, 12])

    def test_a_large_image_on_few_dots_is_smoothed(self):
        _, axes = pyplot.subplots(figsize=(1, 1))
        fine = (np.indices((400, 400)).sum(0) % 2)[..., None].astype(float)
        plot.show(fine, axes=axes)
        middle = drawn(axes.figure)[40:60, 40:60, 0]
        assert np.ptp(middle.astype(int)) < 30

    def test_values_outside_0_to_1_are_clipped(self):
        (picture,) = plot.show(2 * IMAGE - 0.5).get_images()
        assert (picture.get_array().min(), picture.get_array().max()) == (0, 1)

    def test_an_inset_shows_its_pixels_and_overlays(self):
        axes = plot.show(IMAGE, inset=(2, 20, 4, 5), inset_zoom=3, grid=True)
        (child,) = [one for one in axes.child_axes if one.get_label() == INSET]
        (picture,) = child.get_images()
        np.testing.assert_array_equal(picture.get_array(), IMAGE[2:6, 20:25])
        assert tuple(picture.get_extent()) == (20, 25, 6, 2)
        before = len(child.collections)
        plot.triangles(SCENE, axes=axes)
        assert len(child.collections) == before + 1
        plot.arrows([[21.0, 3]], [[60.0, 0]], axes=axes)
        assert (child.get_xlim(), child.get_ylim()) == ((20, 25), (6, 2))

    @pytest.mark.parametrize(
        ("image", "options", "message"),
        [
            (IMAGE[0], {}, "height, width"),
            (np.full((2, 2, 3), np.nan), {}, "row 0, column 0, channel 0 is nan"),
            (np.zeros((2, 2, 3), np.uint8), {}, "holds floats"),
            (IMAGE, {"inset": (0, 0, 0, 2)}, "`inset` must lie inside"),
            (IMAGE, {"inset": (0, 0, 2, 2), "inset_zoom": 1}, "`inset_zoom` must be more than 1"),
            (IMAGE, {"inset": (0, 0, 30, 3)}, "`inset` must lie inside"),
            (IMAGE, {"inset": (0, 0, 19, 29)}, "`inset` must be smaller"),
        ],
    )
    def test_invalid_images_and_insets_are_refused(self, image, options, message):
        with pytest.raises(ValueError, match=message) as caught:
            plot.show(image, **options)
        assert "\n" not in str(caught.value)


class TestOverlays:
    def test_outlines_are_the_triangles(self):
        axes = plot.show(IMAGE)
        plot.triangles(SCENE, axes=axes, vertices=True)
        paths = [path.vertices[:3] for path in axes.collections[-1].get_paths()]
        corners = np.asarray(SCENE.positions)[np.asarray(SCENE.triangles)]
        np.testing.assert_allclose(paths, corners)
        assert {tuple(point) for point in axes.lines[-1].get_xydata().tolist()} == {
            tuple(point) for point in np.asarray(SCENE.positions).tolist()
        }
        assert axes.get_ylim() == (20, 0)

    def test_empty_axes_get_limits(self):
        _, axes = pyplot.subplots()
        plot.triangles(SCENE, axes=axes)
        low, high = sorted(axes.get_ylim())
        assert low < 3
        assert high > 18
        assert axes.yaxis_inverted()

    def test_a_batch_of_scenes_is_refused(self):
        batch = jax.tree.map(lambda leaf: np.stack([leaf, leaf]), SCENE)
        with pytest.raises(ValueError, match="one scene, not a batch"):
            plot.triangles(batch, axes=plot.show(IMAGE))

    def test_tiny_gradients_are_scaled_too(self):
        axes = plot.show(IMAGE)
        plot.arrows([[5.0, 5]], [[1e-310, 0]], axes=axes, length=4)
        np.testing.assert_allclose(axes.collections[-1].U, [4])

    def test_the_longest_arrow_has_its_length(self):
        axes = plot.show(IMAGE)
        vectors = np.array([[3.0, 4], [0, 1], [0, 0], [1, 0]])
        plot.arrows(SCENE.positions, vectors, axes=axes, length=10, label="slope")
        (quiver,) = [one for one in axes.collections if hasattr(one, "U")]
        lengths = np.hypot(quiver.U, quiver.V)
        np.testing.assert_allclose(lengths, [10, 2, 0, 2])
        assert [text.get_text() for text in axes.get_legend().get_texts()] == ["slope"]

    @pytest.mark.parametrize(
        ("vectors", "length", "message"),
        [
            (np.zeros((3, 2)), None, "`vectors` must have the shape"),
            (np.full((4, 2), np.inf), None, "must be finite; number 0"),
            (np.ones((4, 2)), -1.0, "`length` must be positive"),
        ],
    )
    def test_invalid_arrows_are_refused(self, vectors, length, message):
        with pytest.raises(ValueError, match=message):
            plot.arrows(SCENE.positions, vectors, axes=plot.show(IMAGE), length=length)


class TestComparison:
    def test_differences_have_signs_and_errors_have_none(self):
        brighter = np.clip(IMAGE + 0.1, None, 1.2)
        signed = plot.difference(brighter, IMAGE).get_images()[0]
        assert signed.norm.vmin == -signed.norm.vmax
        np.testing.assert_allclose(signed.get_array(), (brighter - IMAGE).mean(-1), atol=1e-6)
        shown_error = plot.error(IMAGE, brighter, limit=0.3).get_images()[0]
        expected = np.sqrt(((brighter - IMAGE) ** 2).mean(-1))
        np.testing.assert_allclose(shown_error.get_array(), expected, atol=1e-6)
        assert (shown_error.norm.vmin, shown_error.norm.vmax) == (0, 0.3)

    def test_colours_of_alpha_zero_do_not_count(self):
        clear, other = np.zeros((2, 2, 4)), np.ones((2, 2, 4))
        other[..., 3] = 0
        assert not plot.error(clear, other).get_images()[0].get_array().any()

    def test_equal_images_have_limits_above_zero(self):
        assert plot.difference(IMAGE, IMAGE).get_images()[0].norm.vmax > 0

    def test_different_shapes_and_limits_of_zero_are_refused(self):
        with pytest.raises(ValueError, match="must have one shape"):
            plot.error(IMAGE, IMAGE[1:])
        with pytest.raises(ValueError, match="`limit` must be positive"):
            plot.error(IMAGE, IMAGE, limit=0)


def fitted(pace):
    history = tuple(Record(10 * k, pace * k, 20.0 + k, 0.9, k, 5) for k in range(1, 6))
    return sr.FitResult(SCENE, IMAGE, 25.0, 0.9, history, {})


class TestConvergence:
    @pytest.mark.parametrize(("against", "last"), [("seconds", 2.5), ("step", 50)])
    def test_lines_show_the_histories(self, against, last):
        axes = plot.convergence({"adam": fitted(0.5)}, against=against)
        ((x, y),) = [line.get_data() for line in axes.lines]
        assert x[-1] == last
        np.testing.assert_array_equal(y, np.arange(21, 26))
        assert axes.get_ylabel().endswith("(dB)")

    def test_no_results_are_refused(self):
        with pytest.raises(ValueError, match="at least one result"):
            plot.convergence({})


class TestStrips:
    def test_frames_are_in_reading_order(self):
        figure = plot.film_strip([IMAGE, IMAGE[::2], IMAGE], titles=["a", "b", "c"], columns=2)
        assert [axes.get_title() for axes in figure.axes] == ["a", "b", "c"]
        boxes = [axes.get_position() for axes in figure.axes]
        # Images of other shapes are centred in cells of one size.
        middle = [(box.y0 + box.y1) / 2 for box in boxes]
        assert middle[0] == pytest.approx(middle[1])
        assert boxes[2].y1 < boxes[0].y0

    def test_wrong_numbers_of_frames_and_titles_are_refused(self):
        with pytest.raises(ValueError, match="`frames` must hold"):
            plot.film_strip([])
        with pytest.raises(ValueError, match="`titles` must be none or 1"):
            plot.film_strip([IMAGE], titles=["a", "b"])

    def test_every_level_of_a_pyramid_is_shown(self):
        textures = sr.TexturePyramid.build([IMAGE, IMAGE[:4, :8]])
        titles = [axes.get_title() for axes in plot.pyramid(textures, 1).axes]
        assert titles == ["level 0: 8 x 4", "level 1: 4 x 2", "level 2: 2 x 1", "level 3: 1 x 1"]
        with pytest.raises(ValueError, match="`index` must be 0 to 1"):
            plot.pyramid(textures, 2)

    def test_an_animation_has_the_given_frames(self, tmp_path):
        path = plot.animate(tmp_path / "a.gif", (IMAGE[..., :1] * k for k in (0.2, 0.9)))
        with Image.open(path) as film:
            frames = [np.asarray(one.convert("RGB")) for one in ImageSequence.Iterator(film)]
        for frame, light in zip(frames, (0.2, 0.9), strict=True):
            expected = np.repeat(IMAGE[..., :1] * light * 255, 3, axis=-1)
            np.testing.assert_allclose(frame, expected, atol=2)

    def test_alpha_is_composited_over_white(self, tmp_path):
        path = plot.animate(tmp_path / "a.gif", [np.array([[[1, 0, 0, 0.5], [0, 0, 0, 0]]])])
        with Image.open(path) as film:
            frame = np.asarray(film.convert("RGB"))
        np.testing.assert_array_equal(frame, [[[255, 128, 128], [255, 255, 255]]])

    def test_invalid_animations_are_refused(self, tmp_path):
        with pytest.raises(ValueError, match="there are no frames"):
            plot.animate(tmp_path / "a.gif", [])
        with pytest.raises(ValueError, match="suffix"):
            plot.animate(tmp_path / "a.png", [IMAGE])
        with pytest.raises(ValueError, match="`seconds_per_frame` must be"):
            plot.animate(tmp_path / "a.gif", [IMAGE], seconds_per_frame=0)


class TestExplore:
    def test_no_values_are_refused(self):
        with pytest.raises(ValueError, match="at least one value"):
            plot.explore(lambda v: IMAGE, [1], name="light", static=[])

    def test_without_a_front_end_a_film_strip_is_drawn(self, capsys):
        figure = plot.explore(lambda v: IMAGE * v, [0.1, 0.5], name="light", static=[0.25, 1.0])
        assert [axes.get_title() for axes in figure.axes] == ["light: 0.25", "light: 1"]
        assert not capsys.readouterr().out

    def test_a_slider_draws_the_chosen_value(self):
        pytest.importorskip("ipywidgets")
        asked = []

        def draw(value):
            asked.append(value)
            return IMAGE

        chosen, picture = slider(draw, [1, 2, 3], "number").children
        first = picture.value
        assert bytes(first).startswith(b"\x89PNG")
        chosen.value = 3
        assert asked == [1, 3]


def test_without_matplotlib_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.delitem(sys.modules, "matplotlib.pyplot", raising=False)
    with pytest.raises(ImportError, match=r"pip install .softras2d\[plot\]"):
        plot.show(IMAGE)


def test_importing_the_package_loads_no_matplotlib():
    script = """
import sys
import softras2d
softras2d.plot.show
print([name for name in ("matplotlib", "jax", "ipywidgets") if name in sys.modules])
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.strip() == "[]"
