"""Written drawings contain fallbacks for browsers: gradients in place of corner colours, no seams.

The package itself ignores the fallbacks when it reads such a drawing.
"""

import warnings
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

import softras2d as sr
from softras2d.io.svg.writing.browser_gradients import (
    VISIBLE,
    fit_gradients,
    hard_light,
    in_browsers,
)
from softras2d.io.svg.writing.seams import shares_edge, tiles_canvas

SQUARE = np.array([[[0, 0], [9, 0], [0, 9]], [[9, 9], [0, 9], [9, 0]]], np.float32)
"""Two triangles that tile 9 x 9 pixels."""


def write(path, corners, colors, size=9) -> list[ElementTree.Element]:
    """The elements of a scene's file, without their namespace."""
    scene = sr.Scene.from_soup(np.asarray(corners, np.float32), np.asarray(colors, np.float32))
    sr.write_svg(path, scene, height=size, width=size, fallback=True)
    root = ElementTree.parse(path).getroot()
    for element in root.iter():
        element.tag = element.tag.split("}")[-1]
    return list(root)


def test_a_tiling_has_a_style_seams_and_a_group(tmp_path):
    style, seams, group = write(tmp_path / "a.svg", SQUARE, [[1, 0, 0], [0, 1, 0]])
    assert (style.tag, seams.tag, group.tag) == ("style", "g", "g")
    assert "plus-lighter" in (style.text or "")
    (line,) = seams
    assert line.attrib == {"stroke": "#ff0000", "d": "M9 0 0 9"}
    assert [e.tag for e in group] == ["polygon", "polygon"]
    assert all("data-fallback" not in e.attrib for e in group)


def test_abutting_triangles_elsewhere_have_seams_alone(tmp_path):
    apart = SQUARE[:1] + 20
    seams, *polygons = write(tmp_path / "a.svg", [*SQUARE, *apart], np.eye(3), size=40)
    assert seams.tag == "g"
    assert [e.tag for e in polygons] == ["polygon"] * 3


@pytest.mark.parametrize("alphas", [(0.5, 1.0), (1.0, 0.5), (0.5, 0.5)])
def test_translucent_triangles_are_drawn_once(tmp_path, alphas):
    colors = [[1, 0, 0, alphas[0]], [0, 1, 0, alphas[1]]]
    assert [e.tag for e in write(tmp_path / "a.svg", SQUARE, colors)] == ["polygon", "polygon"]


def test_colours_along_one_direction_are_one_gradient(tmp_path):
    colors = [[[0, 0, 0], [0.8, 0.4, 0], [0, 0, 0]]]
    definitions, path, colortri = write(tmp_path / "a.svg", SQUARE[:1], colors)
    assert [e.tag for e in (definitions, path, colortri)] == ["defs", "path", "colortri"]
    (gradient,) = definitions
    # The gradient runs from the edge at x = 0 to the corner at x = 9, shortened by the inset.
    ends = [float(gradient.attrib[name]) for name in ("x1", "y1", "x2", "y2")]
    np.testing.assert_allclose(ends, [0.3, ends[1], 8.7, ends[1]], atol=1e-3)
    assert path.get("fill") == f"url(#{gradient.get('id')})"
    assert len(gradient) == 2


def test_translucent_gradients_have_opacities(tmp_path):
    colors = [[[1, 0, 0, 1.0], [1, 0, 0, 0.5], [1, 0, 0, 1.0]]]
    definitions, path, _ = write(tmp_path / "a.svg", SQUARE[:1], colors)
    opacities = [stop.get("stop-opacity", "1") for stop in definitions[0]]
    np.testing.assert_allclose([float(text) for text in opacities], [0.517, 0.983], atol=2e-3)
    assert "shape-rendering" not in path.attrib


def test_two_gradients_reach_colours_of_rank_two():
    rng = np.random.default_rng(0)
    points = rng.random((200, 3, 2)).astype(np.float32) * 50
    colors = rng.uniform(0.3, 0.7, (200, 3, 3)).astype(np.float32)
    fit = fit_gradients(points, colors)
    error = np.abs(fit.shown - colors).max(axis=(1, 2))
    assert fit.has_second.mean() > 0.5
    assert error[~fit.has_second].max() <= VISIBLE
    # The second gradient would be exact over the mean colour, and is nearly so over the first one.
    assert np.median(error[fit.has_second]) < 0.03


def test_hard_light_with_grey_changes_nothing():
    below = np.linspace(0, 1, 11)
    np.testing.assert_allclose(hard_light(below, np.full(11, 0.5)), below, atol=1e-15)


def test_triangles_of_no_area_and_equal_colours_are_painted_flat():
    points = np.array([[[0, 0], [1, 1], [2, 2]], [[0, 0], [4, 0], [0, 4]]], np.float32)
    colors = np.full((2, 3, 3), 0.25, np.float32)
    colors[0, 1] = 1.0
    fit = fit_gradients(points, colors)
    assert not fit.first.is_valid.any()
    np.testing.assert_allclose(fit.shown, fit.mean[:, None].repeat(3, 1))


def test_flat_scenes_look_the_same_in_browsers():
    scene = sr.Scene.from_soup(SQUARE, np.eye(3, dtype=np.float32)[:2])
    assert in_browsers(scene) is scene


NOT_TILINGS = {
    "empty": np.zeros((0, 3, 2), np.float32),
    "half": SQUARE[:1],
    "twice": np.concatenate([SQUARE, SQUARE]),
    "overlap": np.stack([SQUARE[0], SQUARE[0][::-1]]),
    "elsewhere": SQUARE + 1,
    "no area": np.concatenate([SQUARE, SQUARE[:, [0, 1, 1]]]),
}


def test_tilings_of_either_winding_are_recognized():
    assert tiles_canvas(SQUARE, 9, 9)
    assert tiles_canvas(np.stack([SQUARE[0], SQUARE[1][::-1]]), 9, 9)
    assert not tiles_canvas(SQUARE, 9, 10)
    for name, points in NOT_TILINGS.items():
        assert not tiles_canvas(points, 9, 9), name


def test_shared_edges_are_found_by_position():
    apart = SQUARE[:1] + 20
    corner = SQUARE[:1] * [-1, -1]
    points = np.concatenate([SQUARE, apart, corner]).astype(np.float32)
    assert shares_edge(points).tolist() == [True, True, False, False]


@pytest.mark.parametrize("dialect", ["svg", "course"])
def test_readers_skip_fallbacks_without_a_warning(tmp_path, dialect):
    colors = np.random.default_rng(1).random((2, 3, 3))
    write(tmp_path / "a.svg", SQUARE, colors)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read = sr.read_svg(tmp_path / "a.svg", dialect=dialect, frame=False)
    assert read.triangles.shape == (2, 3)
    np.testing.assert_array_equal(read.colors, colors.astype(np.float32))
