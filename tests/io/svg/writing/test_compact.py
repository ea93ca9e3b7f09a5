"""Small SVG files: few decimals, relative coordinates, one path for all triangles of a colour."""

import numpy as np
import pytest

import softras2d as sr
from softras2d.io.svg.writing.short_numbers import (
    join_numbers,
    short_color,
    triangle_path,
    unit_text,
)


@pytest.mark.parametrize(
    ("units", "digits", "text"),
    [(0, 2, "0"), (5, 2, ".05"), (-250, 3, "-.25"), (1200, 2, "12"), (-31, 0, "-31"), (7, 1, ".7")],
)
def test_numbers_are_as_short_as_can_be(units, digits, text):
    assert unit_text(units, digits) == text
    assert float(text) == units / 10**digits


def test_paths_and_colors_are_short():
    assert join_numbers(["1", "-2", ".5"]) == "1-2 .5"
    corners = np.array([[10, 20], [5, 20], [10, 45]])
    assert triangle_path(corners, 1) == "M1 2l-.5 0 .5 2.5z"
    assert short_color(np.array([1.0, 0.2, 0.0])) == "#f30"
    assert short_color(np.array([1.0, 0.5, 0.0])) == "#ff8000"


def image_of(scene: sr.Scene) -> np.ndarray:
    return np.asarray(sr.render(scene, sr.plan(scene, height=40, width=50)))


def write(path, corners, colors, digits=2) -> str:
    scene = sr.Scene.from_soup(corners, colors)
    sr.write_svg(path, scene, height=40, width=50, digits=digits)
    return path.read_text()


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [False, True])
def test_the_image_is_that_of_the_rounded_scene(tmp_path, alpha):
    rng = np.random.default_rng(0)
    corners = np.round(rng.uniform(0, 50, (60, 1, 2)) + rng.uniform(-9, 9, (60, 3, 2)), 2)
    colors = np.array([[255, 0, 0], [0, 102, 51], [0, 0, 200]])[rng.integers(0, 3, 60)] / 255
    if alpha:
        colors = np.concatenate([colors, np.full((60, 1), 0.5)], 1)
    text = write(tmp_path / "a.svg", corners, colors)
    assert text.count("fill=") < 60
    sr.write_svg(
        tmp_path / "long.svg", sr.Scene.from_soup(corners, colors), height=40, width=50
    )  # fmt: skip
    assert len(text) < 0.6 * (tmp_path / "long.svg").stat().st_size
    expected = image_of(sr.Scene.from_soup(corners, colors))
    np.testing.assert_allclose(image_of(sr.read_svg(tmp_path / "a.svg")), expected, atol=0.3 / 255)


def test_a_triangle_joins_no_path_over_which_another_was_drawn(tmp_path):
    apart = [[[0, 0], [9, 0], [0, 9]], [[20, 0], [29, 0], [20, 9]], [[0, 20], [9, 20], [0, 29]]]
    red, blue = [1.0, 0, 0], [0, 0, 1.0]
    assert write(tmp_path / "a.svg", apart, [red, blue, red]).count("<path") == 2
    over = [apart[0], [[1, 1], [8, 2], [2, 9]], [[2, 2], [7, 1], [3, 8]]]
    assert write(tmp_path / "a.svg", over, [red, blue, red]).count("<path") == 3


def test_triangles_that_share_edges_keep_their_seam_lines(tmp_path):
    square = [[[5, 5], [25, 5], [5, 25]], [[25, 5], [25, 25], [5, 25]]]
    text = write(tmp_path / "a.svg", square, [[1.0, 0, 0], [0, 0, 1.0]], digits=0)
    assert "data-fallback" in text
    assert '<path fill="#f00" d="M5 5l20 0-20 20z"/>' in text
    assert sr.read_svg(tmp_path / "a.svg").triangles.shape == (2, 3)


def test_triangles_without_area_are_left_out(tmp_path):
    thin = [[[0, 0], [9, 0], [5, 0.02]], [[0, 10], [9, 10], [5, 18]]]
    assert write(tmp_path / "a.svg", thin, [[0, 0, 0], [0, 0, 0]], digits=1).count("M") == 1


def test_corner_colors_have_short_numbers_too(tmp_path):
    rng = np.random.default_rng(0)
    scene = sr.Scene.from_soup(rng.uniform(0, 40, (5, 3, 2)), rng.random((5, 3, 3)))
    sr.write_svg(tmp_path / "a.svg", scene, height=40, width=50, digits=1)
    again = sr.read_svg(tmp_path / "a.svg")
    expected = np.round(np.asarray(scene.positions), 1)
    np.testing.assert_array_equal(again.positions, expected)
    np.testing.assert_allclose(again.colors, scene.colors, atol=0.51 / 255)


def test_other_digits_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"`digits` must be an integer in 0\.\.6; got 7"):
        write(tmp_path / "a.svg", [[[0, 0], [9, 0], [0, 9]]], [[0, 0, 0]], digits=7)
