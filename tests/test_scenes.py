"""The bundled scenes: what is in the files, and that each has what its purpose needs."""

import math
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

import softras2d as sr
from softras2d import scenes
from softras2d.scenes.make import MADE, SIZE

NAMES = scenes.names()


def test_every_file_is_a_named_scene():
    folder = scenes.path(NAMES[0]).parent
    assert {file.stem for file in folder.glob("*.svg")} == set(NAMES)


def test_unknown_name_is_one_clear_line():
    with pytest.raises(ValueError, match="no bundled scene 'nothing'; there are hairlines,"):
        scenes.path("nothing")


@pytest.mark.parametrize("name", NAMES)
def test_files_are_small_and_say_their_purpose(name):
    assert scenes.path(name).stat().st_size < 120_000
    assert 20 < len(scenes.purpose(name)) < 150
    assert scenes.purpose(name).endswith(".")


@pytest.mark.parametrize("name", MADE)
def test_made_files_are_what_the_script_writes(name):
    assert scenes.path(name).read_text(encoding="utf-8") == MADE[name]()


@pytest.mark.parametrize("name", NAMES)
def test_scenes_are_read_without_a_warning(name):
    scene = scenes.read(name)
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles)]
    assert len(corners) >= 20
    assert (corners.max(axis=(0, 1)) <= 1.1 * SIZE).all()
    root = ElementTree.parse(scenes.path(name)).getroot()
    assert (root.get("width"), root.get("height")) == (str(SIZE), str(SIZE))


def test_structures():
    assert scenes.read("wheel").colors.shape[1:] == (3, 3)
    assert scenes.read("glass").colors.shape[1:] == (1, 4)
    for name in set(NAMES) - {"wheel", "glass"}:
        assert scenes.read(name).colors.shape[1:] == (1, 3), name
    assert scenes.read("mesh").triangles.shape == (1500, 3)


def test_mesh_tiles_the_picture():
    scene = scenes.read("mesh")
    corners = np.asarray(scene.positions, np.float64)[np.asarray(scene.triangles)]
    x1, y1 = (corners[:, 1] - corners[:, 0]).T
    x2, y2 = (corners[:, 2] - corners[:, 0]).T
    areas = np.abs(x1 * y2 - x2 * y1) / 2
    assert areas.min() > 1.0
    assert areas.sum() == pytest.approx(SIZE**2, abs=0.5)


def samples_on_edges(corners: np.ndarray, rate: int) -> int:
    """How many (edge of `[n, 3, 2]`, row of samples) have a sample exactly on the edge."""
    # In Python's integers, of 2^-30 px. Sample i lies at (2i + 1) / (2 rate).
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
    # Under the inclusive rule a sample on a shared edge would be blended twice.
    scene = scenes.read("glass")
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles)]
    panes = corners[np.asarray(scene.colors)[:, 0, 3] < 1]
    assert len(panes) == 114
    assert samples_on_edges(panes, rate) == 0


def test_glass_shows_no_seam():
    scene = scenes.read("glass")
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=sr.Hard(samples=1))
    image = np.asarray(sr.render(scene, plan))
    # Paper, stripe and moon, bare and through each of four tints. A seam would be another colour.
    assert len(np.unique(image.reshape(-1, 3).round(4), axis=0)) == 3 + 3 * 4


@pytest.mark.parametrize("rate", [1, 2, 4])
def test_edges_of_the_squares_meet_samples(rate):
    scene = scenes.read("squares")
    assert samples_on_edges(np.asarray(scene.positions)[np.asarray(scene.triangles)], rate) > 500
