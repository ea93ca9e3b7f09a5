"""The bundled scenes have their files and structure, and the properties that they demonstrate."""

import math
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

import softras2d as sr
from experiments.bundled_scenes.make import MADE, PICTURES, write
from softras2d import scenes
from softras2d.scenes import SIZE
from softras2d.scenes.scripted import SCRIPTED

NAMES = scenes.names()
FILES = [name for name in NAMES if not scenes.is_scripted(name)]
FOLDER = scenes.path("joints").parent
TEXTURED = {"minified", "zone_plate", "stretched", "magnified"}


def test_every_file_is_a_named_scene():
    assert {file.stem for file in FOLDER.glob("*.svg")} == set(FILES)
    assert set(NAMES) - set(FILES) == set(SCRIPTED)
    assert {file.stem for file in (FOLDER / "textures").iterdir()} == set(PICTURES)


@pytest.mark.parametrize("ask", [scenes.path, scenes.purpose, scenes.read, scenes.is_scripted])
def test_unknown_names_are_refused_in_one_line(ask):
    with pytest.raises(ValueError, match="no bundled scene 'nothing'; there are hairlines,"):
        ask("nothing")


def test_a_scripted_scene_has_no_file():
    with pytest.raises(ValueError, match=r"^the bundled scene 'ground' has no file; scenes\.read"):
        scenes.path("ground")


@pytest.mark.parametrize("name", NAMES)
def test_scenes_have_a_purpose_in_one_sentence(name):
    assert 20 < len(scenes.purpose(name)) < 150
    assert scenes.purpose(name).endswith(".")


def test_files_are_small():
    assert max(scenes.path(name).stat().st_size for name in FILES) < 120_000
    sizes = [file.stat().st_size for file in (FOLDER / "textures").iterdir()]
    assert max(sizes) < 20_000 and sum(sizes) < 50_000


@pytest.mark.parametrize("name", MADE)
def test_made_files_are_what_the_script_writes(name):
    assert scenes.path(name).read_text(encoding="utf-8") == MADE[name]()


@pytest.mark.parametrize("name", PICTURES)
def test_pictures_are_what_the_script_draws(name):
    # Pixels are compared instead of files, since compression may change with the library.
    drawn = PICTURES[name]()
    stored = sr.read_image(FOLDER / "textures" / f"{name}.png")
    assert stored.shape[:2] == drawn.shape[:2]
    np.testing.assert_array_equal(
        np.rint(stored * 255), np.rint(np.broadcast_to(drawn, stored.shape) * 255)
    )


def test_the_script_writes_all_it_makes(tmp_path):
    write(tmp_path)
    assert {file.stem for file in tmp_path.glob("*.svg")} == set(MADE)
    assert {file.stem for file in (tmp_path / "textures").iterdir()} == set(PICTURES)
    assert (tmp_path / "stretched.svg").read_text() == scenes.path("stretched").read_text()
    assert sr.read_svg(tmp_path / "stretched.svg").textures is not None


@pytest.mark.parametrize("name", FILES)
def test_scenes_are_read_without_a_warning(name):
    scene = scenes.read(name)
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles)]
    assert len(corners) >= (8 if name in TEXTURED else 20)
    if name != "stretched":
        assert (corners.max(axis=(0, 1)) <= 1.1 * SIZE).all()
    root = ElementTree.parse(scenes.path(name)).getroot()
    assert (root.get("width"), root.get("height")) == (str(SIZE), str(SIZE))


@pytest.mark.parametrize("name", SCRIPTED)
def test_scripted_scenes_fit_the_canvas_that_is_asked_for(name):
    """Scripted scenes fill the height of a canvas; a wider canvas shows more at the sides."""
    scene, wide = scenes.read(name), scenes.read(name, width=2 * SIZE)
    moved = np.asarray(scene.positions) + np.array([SIZE / 2, 0])
    np.testing.assert_allclose(wide.positions, moved, rtol=1e-5, atol=1e-3)
    small = scenes.read(name, height=30, width=30)
    np.testing.assert_allclose(small.positions, scene.positions / 10, rtol=1e-5, atol=1e-4)


def test_scenes_have_the_structure_of_their_effects():
    assert scenes.read("wheel").colors.shape[1:] == (3, 3)
    assert scenes.read("glass").colors.shape[1:] == (1, 4)
    for name in set(NAMES) - {"wheel", "glass"}:
        assert scenes.read(name).colors.shape[1:] == (1, 3), name
    for name in NAMES:
        scene = scenes.read(name)
        assert (scene.textures is not None) == (name in TEXTURED | {"ground"}), name
        assert (scene.depth is not None) == (name in SCRIPTED), name
        assert (scene.inverse_w is not None) == (name in SCRIPTED), name
    assert scenes.read("mesh").triangles.shape == (1500, 3)


def texels_per_pixel(name: str) -> np.ndarray:
    """Texels per pixel `[triangles, 2]` along the longer and the shorter axis of the footprint."""
    scene = scenes.read(name)
    assert scene.uv is not None and scene.textures is not None
    corners = np.asarray(scene.positions, np.float64)[np.asarray(scene.triangles)]
    pixels = corners[:, 1:] - corners[:, :1]
    uv = np.asarray(scene.uv, np.float64)
    _, height, width = np.asarray(scene.textures.levels)[0, 0]
    texels = (uv[:, 1:] - uv[:, :1]) * [width, height]
    return np.linalg.svd(np.linalg.solve(pixels, texels), compute_uv=False)


def test_textured_scenes_have_the_footprints_they_are_meant_for():
    """Each textured scene has the footprints, in texels per pixel, that it should demonstrate."""
    minified = texels_per_pixel("minified")
    np.testing.assert_allclose(minified[:, 0], minified[:, 1], rtol=1e-2)
    assert minified.min() < 2.6 and minified.max() > 42
    np.testing.assert_allclose(texels_per_pixel("zone_plate"), 320 / 150, rtol=1e-6)
    long, short = texels_per_pixel("stretched").T
    np.testing.assert_allclose(short, 256 / 420, rtol=1e-2)
    assert long.min() < 2.4 and long.max() > 30
    assert texels_per_pixel("magnified").max() < 1 / 8


def test_the_zone_plate_alternates_at_its_border():
    """Along its border the pattern alternates from texel to texel, about mid-grey."""
    quarter = PICTURES["zone_quarter"]()[..., 0]
    last = quarter[0, -12:] - 0.5
    assert (last[1:] * last[:-1] < 0).all()
    assert quarter.mean() == pytest.approx(0.5, abs=0.01)
    np.testing.assert_array_equal(quarter, quarter.T)


@pytest.mark.parametrize("width", [SIZE, 2 * SIZE])
def test_the_ground_is_cut_at_the_near_plane_and_reaches_the_horizon(width):
    scene = scenes.read("ground", width=width)
    positions, depth = np.asarray(scene.positions), np.asarray(scene.depth)
    # There are 7 strips of two triangles. The near plane cuts one triangle of the first in two.
    assert len(scene.triangles) == 15
    assert (depth == 0).sum() == 3 and depth.max() < 1
    assert np.abs(positions).max() < 20_000
    # The camera looks down by atan(0.3), so the horizon lies above the middle by this angle.
    horizon = SIZE / 2 * (1 - 0.3 / np.tan(np.radians(29)))
    assert 0 < positions[:, 1].min() - horizon < 0.15
    # Below the horizon, the ground reaches from the left border of the canvas to the right one.
    corners = positions[np.asarray(scene.triangles)]
    for y in np.linspace(positions[:, 1].min() + 0.01, SIZE, 200):
        x = [_crossings(corner, y) for corner in corners]
        assert min(map(min, filter(len, x))) < 0 and max(map(max, filter(len, x))) > width


def _crossings(corner: np.ndarray, y: float) -> list[float]:
    """The x at which the edges of a triangle meet a horizontal line."""
    return [
        a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0])
        for a, b in zip(corner, np.roll(corner, -1, axis=0), strict=True)
        if (a[1] - y) * (b[1] - y) < 0
    ]


def test_the_overlap_needs_its_depth():
    """The first triangle is the nearer one, which draw order alone would hide."""
    near, far = np.asarray(scenes.read("overlap").depth).reshape(2, 3)
    assert near.max() < far.min()


def test_the_squares_cross():
    """Each plane has cells on both sides of the others, so no draw order is right."""
    scene = scenes.read("crossing")
    assert scene.triangles.shape == (3 * 2 * 5**2, 3)
    depth = np.asarray(scene.depth)[np.asarray(scene.triangles)].reshape(3, -1)
    assert depth.min(axis=1).max() < depth.max(axis=1).min()


def test_the_mesh_tiles_the_canvas():
    scene = scenes.read("mesh")
    corners = np.asarray(scene.positions, np.float64)[np.asarray(scene.triangles)]
    x1, y1 = (corners[:, 1] - corners[:, 0]).T
    x2, y2 = (corners[:, 2] - corners[:, 0]).T
    areas = np.abs(x1 * y2 - x2 * y1) / 2
    assert areas.min() > 1.0
    assert areas.sum() == pytest.approx(SIZE**2, abs=0.5)


def samples_on_edges(corners: np.ndarray, rate: int) -> int:
    """How many pairs of an edge and a row of samples have a sample exactly on the edge.

    `corners`: `[n, 3, 2]` in pixels.
    """
    # Python's integers hold coordinates in units of 1 / (2^31 rate) px, in which sample i lies at
    # (2 i + 1) 2^30.
    exact = [[[int(v * 2**31 * rate) for v in point] for point in t] for t in corners.tolist()]
    count = 0
    for triangle in exact:
        for (x0, y0), (x1, y1) in zip(triangle, triangle[1:] + triangle[:1], strict=True):
            first, last = (math.floor((y / 2**30 - 1) / 2) for y in sorted((y0, y1)))
            for row in range(first, last + 2):
                y = (2 * row + 1) * 2**30
                if min(y0, y1) <= y <= max(y0, y1):
                    crossing, rest = divmod((y - y0) * (x1 - x0), y1 - y0) if y0 != y1 else (0, 0)
                    on_column = (x0 + crossing) % 2**31 == 2**30
                    count += y0 == y1 or (rest == 0 and on_column)
    return count


@pytest.mark.parametrize("rate", [1, 2, 3, 4, 8, 16])
def test_no_edge_of_the_glass_meets_a_sample(rate):
    # Under the fill rule `inclusive`, a sample on a shared edge would be blended twice.
    scene = scenes.read("glass")
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles)]
    panes = corners[np.asarray(scene.colors)[:, 0, 3] < 1]
    assert len(panes) == 114
    assert samples_on_edges(panes, rate) == 0


def test_the_glass_shows_no_seam():
    scene = scenes.read("glass")
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=sr.Hard(samples=1))
    image = np.asarray(sr.render(scene, plan))
    # Background, stripe and moon are visible bare and through four tints each. A seam would blend
    # two tints and so add a colour.
    assert len(np.unique(image.reshape(-1, 3).round(4), axis=0)) == 3 + 3 * 4


@pytest.mark.parametrize("rate", [1, 2, 4])
def test_edges_of_the_squares_meet_samples(rate):
    scene = scenes.read("squares")
    assert samples_on_edges(np.asarray(scene.positions)[np.asarray(scene.triangles)], rate) > 500
