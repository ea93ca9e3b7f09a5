"""The five classes of scene, and the reference image of each at 1024 samples per pixel."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import softras2d as sr
from softras2d import scenes

from ..common.references import cached_reference
from ..common.scenes import Soup, random_soup

SEED = 0
SLIVERS = 1000
CELLS = 22
"""Cells along a side of the mesh; each is two triangles."""

MIPMAPPED = sr.Filter(pixel="bilinear", level="linear")


@dataclass(frozen=True)
class Subject:
    """One scene on a canvas of `size` x `size` pixels.

    - `soup`: the same triangles without shared vertices, for the peers; None for a textured scene.
    - `tiling`: whether the triangles abut and fill the canvas.
    """

    name: str
    title: str
    size: int
    scene: sr.Scene
    soup: Soup | None = None
    tiling: bool = False

    @property
    def textured(self) -> bool:
        return self.scene.textures is not None


def load(size: int) -> list[Subject]:
    """All scenes; random triangles scale with the canvas, except for the width of slivers."""
    flat, glass = random_soup(1000, size, seed=SEED), random_soup(1000, size, "flat_a50", seed=SEED)
    thin = sliver_soup(size)
    textured = scenes.read("minified", height=size, width=size)
    return [
        Subject("flat", "flat soup, 1,000 triangles", size, _scene(flat), flat),
        mesh(size),
        Subject("translucent", "translucent, 1,000 at alpha 0.5", size, _scene(glass), glass),
        Subject("minified", "textured minification, 174 images", size, textured),
        Subject("slivers", "slivers, 1,000 of 0.2 to 1.5 px", size, _scene(thin), thin),
    ]


def mesh(size: int) -> Subject:
    """A jittered grid in the colours of a photograph; its outermost vertices are off the canvas.

    So no edge lies on the border of the canvas, where the derivative jumps.
    """
    rng = np.random.default_rng(SEED)
    cell = size / (CELLS - 1)
    side = (np.arange(CELLS + 1) - 0.5) * cell
    positions = np.stack(np.meshgrid(side, side), -1)
    inner = positions[1:-1, 1:-1]
    inner += rng.uniform(-0.3, 0.3, inner.shape) * cell
    positions = positions.reshape(-1, 2).astype(np.float32)
    corner = np.arange(CELLS * (CELLS + 1)).reshape(CELLS, CELLS + 1)[:, :-1].ravel()
    a, b, c, d = corner, corner + 1, corner + CELLS + 2, corner + CELLS + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.int32)
    photograph = np.asarray(sr.read_image(sr.pictures.path("fruit")))[..., :3]
    centroid = positions[triangles].mean(1) / size * photograph.shape[0]
    x, y = np.clip(centroid, 0, photograph.shape[0] - 1).astype(int).T
    colors = (np.rint(photograph[y, x] * 255) / 255).astype(np.float32)
    scene = sr.Scene.from_mesh(positions, triangles, triangle_colors=colors)
    soup = _soup(size, positions[triangles], colors)
    title = f"abutting mesh, {len(triangles):,} triangles"
    return Subject("mesh", title, size, scene, soup, tiling=True)


def sliver_soup(size: int) -> Soup:
    """Triangles 0.2 to 1.5 pixels wide at one end, as long as a tenth to 0.4 of the canvas."""
    rng = np.random.default_rng(SEED)
    middle = rng.random((SLIVERS, 1, 2)) * size
    angle = rng.random(SLIVERS) * (2 * np.pi)
    length = rng.uniform(0.1, 0.4, SLIVERS) * size
    width = rng.uniform(0.2, 1.5, SLIVERS)
    along = np.stack([np.cos(angle), np.sin(angle)], -1)
    across = along[:, ::-1] * (-1.0, 1.0) * width[:, None] / 2
    half = along * length[:, None] / 2
    corners = middle + np.stack([half, across - half, -across - half], 1)
    colors = rng.integers(0, 256, (SLIVERS, 3)) / 255
    return _soup(size, corners, colors)


def reference(subject: Subject, cache: Path) -> NDArray[np.float64]:
    """The mean of 1024 samples per pixel, stored under `cache`; see `cached_reference`."""
    return cached_reference(subject.scene, subject.size, cache)


def _soup(size: int, corners: np.ndarray, colors: np.ndarray) -> Soup:
    """A flat opaque soup over white; `colors` is `[triangles, 3]`."""
    corner_colors = np.ones((len(corners), 3, 4), np.float32)
    corner_colors[..., :3] = colors[:, None]
    white = np.ones(3, np.float32)
    return Soup("flat", size, SEED, corners.astype(np.float32), corner_colors, white)


def _scene(soup: Soup) -> sr.Scene:
    """The scene of a soup: one colour per triangle; three channels if opaque."""
    return sr.Scene.from_soup(soup.corners, soup.colors[:, 0, : 3 if soup.opaque else 4])
