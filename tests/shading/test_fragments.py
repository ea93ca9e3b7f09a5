"""Host and device count fragments alike: the pairs of a triangle and a pixel that shows it."""

import numpy as np
import pytest

import softras2d as sr
from softras2d.planning.list_counts import count_sampled_lists
from softras2d.rendering.render import _render

from ..oracles.coverage import Canvas, footprints

HEIGHT, WIDTH, COUNT = 37, 45, 30


def _scene(seed: int, depth: bool, radius: float = 20.0) -> sr.Scene:
    rng = np.random.default_rng(seed)
    centre = rng.uniform(0, 1, (COUNT, 1, 2)) * [WIDTH, HEIGHT]
    corners = centre + rng.uniform(-radius, radius, (COUNT, 3, 2))
    return sr.Scene.from_soup(
        np.clip(corners, -15, 55).astype(np.float32),
        rng.random((COUNT, 3, 3)).astype(np.float32),
        # Depths differ by far more than a rounding, so host and device sort them alike.
        depth=np.repeat(rng.permutation(COUNT)[:, None], 3, 1).astype(np.float32)
        if depth
        else None,
    )


def _expected(scene: sr.Scene, canvas: Canvas) -> int:
    """Count fragments by painting triangle indices at every sample, the nearest triangle last."""
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles)]
    order = np.arange(COUNT)
    if scene.depth is not None:
        order = np.argsort(-np.asarray(scene.depth)[np.asarray(scene.triangles)[:, 0]])
    visible = np.full((HEIGHT * canvas.rate, WIDTH * canvas.rate), -1)
    footprints_drawn = list(footprints(corners, canvas))
    for number in order:
        footprint = footprints_drawn[number]
        before = visible[footprint.rows, footprint.columns]
        visible[footprint.rows, footprint.columns] = np.where(footprint.inside, number, before)
    pixels = visible.reshape(HEIGHT, canvas.rate, WIDTH, canvas.rate).transpose(0, 2, 1, 3)
    pixels = pixels.reshape(HEIGHT * WIDTH, -1)
    return sum(len(set(pixel) - {-1}) for pixel in pixels.tolist())


@pytest.mark.parametrize("depth", [False, True], ids=["painter", "depth"])
@pytest.mark.parametrize("rate", [4, pytest.param(1, marks=pytest.mark.slow)])
def test_counts_on_host_and_device_cover_the_visible_pixels(rate, depth):
    hard = sr.Hard(samples=rate**2, shading="pixel")
    scenes = [_scene(seed, depth) for seed in range(3)]
    plan = sr.plan(scenes, height=HEIGHT, width=WIDTH, coverage=hard)
    for scene in scenes:
        wanted = _expected(scene, Canvas(HEIGHT, WIDTH, rate))
        counted = count_sampled_lists(scene, plan.grid, hard, np.zeros(2, np.int32))
        # If a triangle covers a tile, the host counts all its pixels, even off the canvas.
        spare = plan.tiling.count * plan.tiling.height * plan.tiling.width - HEIGHT * WIDTH
        assert wanted <= counted.fragments <= wanted + spare
        assert int(_render(scene, plan)[1].fragments) == wanted


@pytest.mark.parametrize(("fill_rule", "wanted"), [("inclusive", 1), ("top_left", 0)])
def test_a_triangle_that_is_one_sample_has_at_most_one_fragment(fill_rule, wanted):
    scene = sr.Scene.from_soup(np.full((1, 3, 2), 40.5, np.float32), np.eye(3)[None])
    hard = sr.Hard(samples=1, shading="pixel", fill_rule=fill_rule)
    plan = sr.plan(scene, height=64, width=64, coverage=hard)
    counted = count_sampled_lists(scene, plan.grid, hard, np.zeros(2, np.int32))
    assert counted.fragments == wanted
    changed = (np.asarray(sr.render(scene, plan)) != 1).any(-1)
    assert int(changed.sum()) == wanted


def test_too_many_fragments_are_reported():
    hard = sr.Hard(samples=4, shading="pixel")
    small = [_scene(seed, False, radius=0.5) for seed in range(1)]
    plan = sr.plan(small, height=400, width=400, coverage=hard)
    large = sr.Scene.from_soup(
        np.full((COUNT, 3, 2), [[0, 0], [400, 0], [0, 400]], np.float32), small[0].colors
    )
    _, overflow = sr.render_checked(large, plan)
    assert bool(overflow)
    with pytest.raises(ValueError, match="fragments"):
        sr.render(large, plan)


@pytest.mark.slow
def test_a_plan_counts_all_of_several_surfaces_in_one_plane():
    """Rounding decides which of the surfaces is visible, and may differ between devices."""

    def depth(points: np.ndarray) -> np.ndarray:
        return 0.25 + (3 * points[..., 0] + 5 * points[..., 1]) / 4096

    a, b, c, d = (0, 0), (WIDTH, 0), (0, HEIGHT), (WIDTH, HEIGHT)
    corners = np.array([(a, b, c), (b, d, c), (a, b, d), (a, d, c)] * 2, np.float32)
    scene = sr.Scene.from_soup(
        corners + np.linspace(0, 0.2, 8)[:, None, None].astype(np.float32),
        np.random.default_rng(0).random((8, 3, 3)),
        depth=depth(corners).astype(np.float32),
    )
    hard = sr.Hard(samples=16, shading="pixel")
    plan = sr.plan(scene, height=HEIGHT, width=WIDTH, coverage=hard)
    assert np.isfinite(sr.render(scene, plan)).all()


def test_a_plan_without_shading_has_no_fragments():
    for scene, hard in (
        (_scene(0, False), sr.Hard(samples=4)),
        (sr.Scene.from_soup([[[0, 0], [9, 0], [0, 9]]], [[1.0, 0, 0]]), sr.Hard(shading="pixel")),
    ):
        plan = sr.plan(scene, height=HEIGHT, width=WIDTH, coverage=hard)
        assert plan.capacity.fragments == 0
        assert "fragments" not in str(plan)
