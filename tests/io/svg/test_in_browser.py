"""A browser shows written drawings nearly as the package draws them."""

from pathlib import Path

import numpy as np
import pytest

import softras2d as sr
from softras2d.comparison.screenshot import screenshot
from softras2d.comparison.similarity import psnr
from softras2d.io.svg.writing.browser_gradients import in_browsers

from ...cases.browser import require_browser
from ...cases.marks import slowly

HEIGHT, WIDTH = 144, 192
BACKGROUND = np.array([0.1, 0.1, 0.2], np.float32)


def grid(cells: int, inset: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Positions and triangles of a jittered grid that fills the canvas, except a margin `inset`."""
    rng = np.random.default_rng(3)
    u = np.linspace(0, 1, cells + 1)
    positions = np.stack(np.meshgrid(u, u), -1)
    positions[1:-1, 1:-1] += rng.uniform(-0.3, 0.3, (cells - 1, cells - 1, 2)) / cells
    size = np.array([WIDTH, HEIGHT]) - 2 * inset
    corner = np.arange(cells * (cells + 1)).reshape(cells, cells + 1)[:, :-1].ravel()
    a, b, c, d = corner, corner + 1, corner + cells + 2, corner + cells + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return (positions.reshape(-1, 2) * size + inset).astype(np.float32), rng.permutation(triangles)


def picture_colors(points: np.ndarray) -> np.ndarray:
    """Colours of a bundled picture at points of the canvas, like those of a fit."""
    picture = sr.read_image(sr.pictures.path("fruit"))
    sides = np.array(picture.shape[1::-1])
    column, row = np.clip(points / [WIDTH, HEIGHT] * sides, 0, sides - 1).astype(int).T
    return picture[row, column, :3]


def flat_mesh(cells: int = 14, inset: float = 0.0) -> sr.Scene:
    """A grid whose triangles have the colours of a picture, over black."""
    positions, triangles = grid(cells, inset)
    colors = picture_colors(positions[triangles].mean(axis=1))
    return sr.Scene.from_mesh(
        positions, triangles, triangle_colors=colors, background=np.zeros(3, np.float32)
    )


def shaded_mesh() -> sr.Scene:
    """A grid with the colours of a picture at its vertices."""
    positions, triangles = grid(10)
    colors = picture_colors(positions)
    return sr.Scene.from_mesh(positions, triangles, vertex_colors=colors, background=BACKGROUND)


def layers(*colors_shape: int) -> sr.Scene:
    """Overlapping triangles in random colours of this shape per triangle; 4 channels for alpha."""
    rng = np.random.default_rng(6)
    corners = rng.random((60, 1, 2)) * [WIDTH, HEIGHT] + rng.normal(size=(60, 3, 2)) * 20
    colors = rng.random((60, *colors_shape)).astype(np.float32)
    return sr.Scene.from_soup(corners.astype(np.float32), colors, background=BACKGROUND)


def translucent_mesh() -> sr.Scene:
    """A translucent grid over a darker background, where overlaps would be visible."""
    positions, triangles = grid(3)
    colors = np.full((len(triangles), 4), 0.4, np.float32)
    return sr.Scene.from_mesh(positions, triangles, triangle_colors=colors, background=BACKGROUND)


CASES = {
    # Each case is a scene, and the least PSNR in dB of the browser's image.
    "flat layers": (layers(3), 40.0),
    "translucent layers": (layers(4), 40.0),
    "flat mesh": (flat_mesh(), 40.0),
    "flat mesh in a margin": (flat_mesh(inset=10.25), 35.0),
    "interpolated layers": (layers(3, 3), 38.0),
    "interpolated mesh": (shaded_mesh(), 45.0),
    "translucent mesh": (translucent_mesh(), 45.0),
}


def render(scene: sr.Scene) -> np.ndarray:
    plan = sr.plan(scene, height=HEIGHT, width=WIDTH, coverage=sr.Hard(samples=16))
    return np.asarray(sr.render(scene, plan))


def write_and_browse(path: Path, scene: sr.Scene) -> np.ndarray:
    sr.write_svg(path, scene, height=HEIGHT, width=WIDTH, fallback=True)
    return screenshot(require_browser(), path, height=HEIGHT, width=WIDTH)


@pytest.mark.parametrize(
    "case", [case if case.startswith("flat mesh") else slowly(case) for case in CASES]
)
def test_browsers_draw_nearly_the_same_image(tmp_path, case):
    scene, least = CASES[case]
    assert psnr(write_and_browse(tmp_path / "scene.svg", scene), render(scene)) >= least


@pytest.mark.slow
def test_without_blend_modes_the_image_is_still_near(tmp_path):
    path = tmp_path / "scene.svg"
    for scene, least in ((flat_mesh(), 40.0), (shaded_mesh(), 35.0)):
        sr.write_svg(path, scene, height=HEIGHT, width=WIDTH, fallback=True)
        unknown = path.read_text().replace("mix-blend-mode", "no-such-property")
        path.write_text(unknown)
        shown = screenshot(require_browser(), path, height=HEIGHT, width=WIDTH)
        assert psnr(shown, render(scene)) >= least


@pytest.mark.slow
def test_in_browsers_estimates_the_image_of_a_browser(tmp_path):
    scene = shaded_mesh()
    shown = write_and_browse(tmp_path / "scene.svg", scene)
    assert psnr(shown, render(in_browsers(scene))) >= 45.0
