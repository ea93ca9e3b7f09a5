"""Each window of a canvas lists the triangles whose bounding box it meets, without compiling."""

from typing import Any

import jax
import numpy as np
import pytest

import softras2d as sr
from softras2d.tiled.pieces import piece_class, take_piece
from softras2d.tiled.windows import Boxes, Cut, list_triangles

from ..cases.tiled import HEIGHT, TILE, WIDTH, scene_of


def test_lists_equal_a_loop_over_windows_and_triangles():
    rng = np.random.default_rng(0)
    cut = Cut(100, 150, 32)
    first = np.floor(rng.uniform(-60, 200, (80, 2)))
    boxes = Boxes(first, first + rng.integers(-2, 90, (80, 2)))
    boxes.first[3], boxes.last[3] = -1e30, 1e30
    lists = list_triangles(boxes, cut)
    assert len(lists.triangle) > 100
    for window in cut:
        expected = [
            index
            for index, ((x0, y0), (x1, y1)) in enumerate(zip(boxes.first, boxes.last, strict=True))
            # Triangles off the canvas are not listed, although windows reach beyond it.
            if x0 <= x1 and y0 <= y1 and x0 < 150 and y0 < 100
            if max(x0, 0) < window.x + 32 and x1 >= window.x
            if max(y0, 0) < window.y + 32 and y1 >= window.y
        ]
        np.testing.assert_array_equal(lists.triangles_of(window.number), expected)


def test_windows_tile_the_canvas():
    cut = Cut(HEIGHT, WIDTH, TILE)
    count = np.zeros((HEIGHT, WIDTH), int)
    for window in cut:
        count[window.rows, window.columns] += 1
        assert window == cut.window(window.number)
    assert (count == 1).all()


@pytest.mark.parametrize("size", [(HEIGHT, WIDTH), (1, 64), (64, 65), (66, 130), (20, 300)])
def test_drawn_windows_are_windows_with_their_border_on_the_canvas(size):
    height, width = size
    cut = Cut(height, width, TILE)
    for window in cut:
        drawn = cut.drawn_window(window.number, 1)
        assert (drawn.height, drawn.width) == tuple(min(side, TILE + 2) for side in size)
        for drawn_slice, shown, side in (
            (drawn.rows, window.rows, cut.height),
            (drawn.columns, window.columns, cut.width),
        ):
            assert 0 <= drawn_slice.start <= max(shown.start - 1, 0)
            assert min(shown.stop + 1, side) <= drawn_slice.stop <= side


def test_a_piece_has_the_corners_and_colors_of_its_triangles():
    scene = scene_of("corners depth texture")
    host = sr.Scene(**{name: getattr(scene, name) for name in scene.__dataclass_fields__})
    index = np.array([4, 9, 2], np.int32)
    piece = take_piece(host, index)
    positions, triangles = np.asarray(scene.positions), np.asarray(scene.triangles)
    np.testing.assert_array_equal(
        np.asarray(piece.scene.positions)[np.asarray(piece.scene.triangles)],
        positions[triangles[index]],
    )
    np.testing.assert_array_equal(piece.scene.colors, np.asarray(scene.colors)[index])
    np.testing.assert_array_equal(piece.vertex, np.unique(triangles[index]))
    assert [piece_class(n) for n in (0, 64, 65, 1024, 1025, 20000)] == [
        64, 64, 1024, 1024, 16384, 32768,
    ]  # fmt: skip


def test_invalid_plans_are_refused_in_one_line():
    scene = scene_of()
    for arguments, message in (
        ({"tile": 100}, "`tile` must be a multiple of 32"),
        ({"tile": 32, "coverage": sr.Hard(9)}, "`tile` must be a multiple of 80"),
        ({"height": 0}, "`height` must be an integer in 1"),
        ({"grid_bits": 7}, "`grid_bits` must be"),
    ):
        with pytest.raises(ValueError, match=message):
            given: dict[str, Any] = {"height": 100, "width": 150} | arguments
            sr.plan_tiles(scene, **given)
    plan = sr.plan_tiles(scene, height=HEIGHT, width=WIDTH, tile=TILE)
    with pytest.raises(ValueError, match="gradients=True"):
        sr.tiled_value_and_grad(lambda image: image.sum())(scene, plan)


def test_scenes_windows_and_devices_that_do_not_fit_the_plan_are_refused():
    scene = scene_of()
    plan = sr.plan_tiles(scene, height=HEIGHT, width=WIDTH, tile=TILE)
    other = sr.Scene.from_soup(np.zeros((2, 3, 2), np.float32), np.zeros((2, 3), np.float32))
    cases: list[tuple[sr.Scene, dict[str, Any], str]] = [
        (other, {}, "at least 150 triangles; got one of 2"),
        (scene, {"windows": [0, 6]}, r"`windows` must be in 0\.\.5; got 6"),
        (scene, {"windows": [-1]}, "got -1"),
        (scene, {"devices": ["cpu"]}, r"must be a list of devices of JAX; got \['cpu'\]"),
        (scene, {"devices": []}, "at least one device; got none"),
    ]
    for drawn, options, message in cases:
        with pytest.raises(ValueError, match=message):
            next(sr.render_tiles(drawn, plan, **options))
    with pytest.raises(ValueError, match="outside jit"):
        jax.jit(lambda scene: next(sr.render_tiles(scene, plan))[1])(scene)
