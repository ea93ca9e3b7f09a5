"""Windows of a tiled image have the pixels of the whole canvas, in memory and in files."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

import softras2d as sr

from ..cases.tiled import HEIGHT, TILE, WIDTH, joined, scene_of, whole_image
from ..oracles.coverage import Canvas, draw

EXACT = {
    "flat": (sr.Hard(16), "", TILE),
    "depth": (sr.Hard(4), "corners depth", TILE),
    "alpha": (sr.Hard(4), "alpha", TILE),
    "textured": (sr.Hard(4), "texture", TILE),
    "nine": (sr.Hard(9), "corners", 80),
}


@pytest.mark.parametrize(
    "name", ["flat", *(pytest.param(n, marks=pytest.mark.slow) for n in list(EXACT)[1:])]
)
def test_windows_under_hard_equal_render_to_the_bit_and_so_do_files(name, tmp_path):
    coverage, effects, tile = EXACT[name]
    scene = scene_of(effects)
    expected = whole_image(scene, coverage)
    plan = sr.plan_tiles(scene, height=HEIGHT, width=WIDTH, coverage=coverage, tile=tile)
    np.testing.assert_array_equal(joined(scene, plan), expected)
    for suffix in ("png", "tif", "exr") if name == "flat" else ():
        written, reference = tmp_path / f"tiled.{suffix}", tmp_path / f"whole.{suffix}"
        reports: list[tuple[int, int]] = []
        sr.write_tiles(written, scene, plan, report=_recorder(reports))
        sr.write_image(reference, expected)
        np.testing.assert_array_equal(sr.read_image(written), sr.read_image(reference))
        assert reports == [(k + 1, plan.cut.count) for k in range(plan.cut.count)]
        source = oiio.ImageInput.open(str(written))
        assert source is not None
        assert source.spec().tile_width == (suffix != "png") * TILE
    if name == "flat":
        _check_interruption(scene, plan, tmp_path)


def _recorder(reports: list[tuple[int, int]]) -> Callable[[int, int], None]:
    """A progress function that appends its arguments to `reports`."""
    return lambda done, total: reports.append((done, total))


def _check_interruption(scene: sr.Scene, plan: sr.TiledPlan, folder: Path) -> None:
    """Check that Ctrl-C leaves the old file, and no draft."""
    before = sorted(folder.iterdir())
    for suffix in ("png", "tif", "exr"):
        path = folder / f"tiled.{suffix}"
        old = path.read_bytes()

        def interrupt(done: int, total: int) -> None:
            if done == 3:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            sr.write_tiles(path, scene, plan, report=interrupt)
        assert path.read_bytes() == old
    assert sorted(folder.iterdir()) == before
    with pytest.raises(ValueError, match="suffix of a tiled image must be one of"):
        sr.write_tiles(folder / "tiled.jpg", scene, plan)


@pytest.mark.slow
@pytest.mark.parametrize("coverage", [sr.Soft(1.5), sr.Area(), sr.Area("sum")], ids=str)
def test_windows_of_analytic_coverage_equal_render_up_to_rounding(coverage):
    scene = scene_of("" if coverage == sr.Area("sum") else "alpha")
    plan = sr.plan_tiles(scene, height=HEIGHT, width=WIDTH, coverage=coverage, tile=TILE)
    difference = np.abs(joined(scene, plan) - whole_image(scene, coverage))
    assert difference.max() < 3e-6


def test_windows_of_a_canvas_that_does_not_fit_equal_the_oracle():
    """The canvas has 50,000 pixels a side, and three of its windows are drawn."""
    rng = np.random.default_rng(5)
    side, tile, bits = 50_000, 64, 8
    plan_of = {"height": side, "width": side, "coverage": sr.Hard(4), "tile": 1024}
    starts = [(0, 0), (781 * 64, 300 * 64), (256 * 64, 780 * 64)]
    corners = np.concatenate(
        [
            np.array(start) + rng.uniform(0, 64, (30, 1, 2)) + rng.uniform(-16, 16, (30, 3, 2))
            for start in starts
        ]
    ).astype(np.float32)
    colors = rng.random((len(corners), 3))
    scene = sr.Scene.from_soup(corners, colors)
    plan = sr.plan_tiles(scene, **plan_of)
    numbers = [y // 1024 * plan.cut.columns + x // 1024 for x, y in starts]
    for (x, y), (window, image) in zip(
        starts, sr.render_tiles(scene, plan, windows=numbers), strict=True
    ):
        height, width = (min(tile, side - first) for first in (y, x))
        on = Canvas(tile, tile, 2, origin=(x, y), grid_bits=bits)
        near = (np.abs(corners - [x + 32, y + 32]) < 64).all((1, 2))
        expected = draw(corners[near], colors[near], [1, 1, 1], on)
        drawn = image[y - window.y :, x - window.x :][:height, :width]
        np.testing.assert_allclose(drawn, expected[:height, :width], atol=1e-6)
        assert np.unique(drawn).size > 50
