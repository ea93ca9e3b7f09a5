"""Steering a fit: palettes and frozen numbers."""

from typing import Any

import numpy as np
import pytest

import softras2d as sr
from softras2d.fitting.mesh.start import uniform_start

from ..cases.pictures import blobs

TARGET = blobs(32, 32)
FLAT: dict[str, Any] = {"family": "mesh", "shading": "flat"}


def colors_of(result: sr.FitResult) -> np.ndarray:
    colors = np.asarray(result.scene.colors)[..., :3].reshape(-1, 3)
    return np.unique(colors, axis=0)


@pytest.mark.parametrize(
    "settings",
    [{}, pytest.param({"translucent": True}, marks=pytest.mark.slow), FLAT],
    ids=["layers", "translucent", "mesh"],
)
def test_every_triangle_has_a_color_of_the_palette(settings, tmp_path):
    palette = np.array([[0, 0, 0], [0.9, 0.2, 0.1], [0.1, 0.3, 0.8], [0.6, 0.6, 0.5]], np.float32)
    shown = []

    def report(moment):
        shown.append(np.asarray(moment.scene().colors)[..., :3])

    result = sr.fit(TARGET, triangles=16, palette=palette, steps=48, report=report, **settings)
    allowed = set(map(tuple, palette.tolist()))
    for colors in (*shown, colors_of(result)):
        assert set(map(tuple, colors.reshape(-1, 3).tolist())) <= allowed
    assert len(colors_of(result)) > 2
    result.save(tmp_path / "fit.npz")
    loaded = sr.FitResult.load(tmp_path / "fit.npz")
    longer = sr.fit(TARGET, resume=loaded, steps=54)
    assert set(map(tuple, colors_of(longer).tolist())) <= allowed
    assert longer.psnr > result.psnr - 0.1


def cloud() -> sr.Scene:
    rng = np.random.default_rng(3)
    corners = rng.uniform(0, 32, (6, 1, 2)) + rng.uniform(-9, 9, (6, 3, 2))
    return sr.Scene.from_soup(corners.astype(np.float32), rng.random((6, 3)).astype(np.float32))


SOME = np.array([True, False, True, False, False, True])


@pytest.mark.parametrize(
    "freeze", ["positions", ["colors"], {"triangles": SOME}], ids=["positions", "colors", "mask"]
)
def test_frozen_layers_keep_every_bit(freeze, tmp_path):
    start = cloud()
    settings: dict[str, Any] = {"triangles": 6, "start": start, "size": 27, "freeze": freeze}
    result = sr.fit(TARGET, steps=20, **settings)
    result.save(tmp_path / "fit.npz")
    longer = sr.fit(TARGET, resume=sr.FitResult.load(tmp_path / "fit.npz"), steps=24)
    before, corners = np.asarray(start.colors), np.asarray(start.positions).reshape(-1, 3, 2)
    for fitted in (result, longer):
        same_corners = (np.asarray(fitted.scene.positions).reshape(-1, 3, 2) == corners).all((1, 2))
        same_colors = (np.asarray(fitted.scene.colors) == before).all((1, 2))
        masked = isinstance(freeze, dict)
        np.testing.assert_array_equal(same_corners, SOME if masked else freeze == "positions")
        np.testing.assert_array_equal(same_colors, SOME if masked else freeze == ["colors"])


@pytest.mark.parametrize("shading", ["gouraud", pytest.param("flat", marks=pytest.mark.slow)])
def test_frozen_vertices_and_triangles_of_a_mesh_keep_every_bit(shading, tmp_path):
    mesh = uniform_start(32, 32, 25, jitter=0.2)
    vertices, triangles = np.zeros(25, bool), np.zeros(len(mesh.triangles), bool)
    vertices[[7, 12]] = triangles[3] = True
    settings: dict[str, Any] = {
        "triangles": 60, "family": "mesh", "shading": shading, "start": mesh,
        "freeze": {"vertices": vertices, "triangles": triangles},
    }  # fmt: skip
    before = sr.fit(TARGET, steps=0, **settings)
    after = sr.fit(TARGET, steps=20, **settings)
    after.save(tmp_path / "fit.npz")
    longer = sr.fit(TARGET, resume=sr.FitResult.load(tmp_path / "fit.npz"), steps=24)
    kept = vertices.copy()
    kept[mesh.triangles[3]] = True
    for result in (after, longer):
        same = np.asarray(result.scene.positions) == np.asarray(before.scene.positions)
        free = mesh.free_x & mesh.free_y
        np.testing.assert_array_equal(same.all(1)[free], kept[free])
        colors = np.asarray(result.scene.colors), np.asarray(before.scene.colors)
        np.testing.assert_array_equal(colors[0][3], colors[1][3])
        assert (colors[0] != colors[1]).any()


@pytest.mark.slow
def test_added_triangles_stay_where_they_were_placed():
    scenes = []
    result = sr.fit(
        TARGET, triangles=12, freeze="positions", steps=40,
        report=lambda moment: scenes.append((moment.record.active, moment.scene())),
    )  # fmt: skip
    for active, scene in scenes:
        placed = np.asarray(scene.positions)[: 3 * active]
        np.testing.assert_array_equal(placed, np.asarray(result.scene.positions)[: 3 * active])
    assert scenes[0][0] < scenes[-1][0] == 12


REFUSED: dict[str, dict[str, Any]] = {
    "`palette` must be a number of colours from 1 to 256": {"palette": 0},
    "or as many colours": {"palette": [[0, 0, 2]]},
    "got 'red'": {"palette": "red"},
    "it needs `shading='flat'`; got 'gouraud'": {"palette": 4, "shading": "gouraud"},
    "it needs `colors='together'`; got 'solve'": {"palette": 4, "colors": "solve"},
    "must have names from 'positions', 'colors'": {"freeze": "shapes"},
    "names, or a mapping from names; got 3": {"freeze": 3},
    "of 'triangles' needs a boolean mask": {"freeze": "triangles"},
    "of 'positions' must be True; got 1": {"freeze": {"positions": 1}},
    "of 'vertices' is for a mesh": {"freeze": {"vertices": SOME}},
    "of 'opacity' needs `translucent=True`": {"freeze": "opacity"},
    "needs a scene or mesh as `start`": {"freeze": {"triangles": SOME}},
    "must be a mask of 6 triangles, as `start` has; got 2": {
        "start": cloud(), "freeze": {"triangles": SOME[:2]},
    },
    "do not `freeze` 'colors'": {"freeze": "colors", "palette": 3},
    "'colors' needs `colors='together'`": {"freeze": "colors", "colors": "polish"},
}  # fmt: skip


@pytest.mark.parametrize("message", REFUSED)
def test_invalid_steering_is_refused_in_one_line(message):
    with pytest.raises(ValueError) as caught:
        sr.fit(TARGET, **REFUSED[message])
    assert message in str(caught.value) and "\n" not in str(caught.value)
