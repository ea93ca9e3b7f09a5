"""Draw one tiling under each coverage mode, and measure how much background shows in seams.

python -m experiments.seams.run
"""

# pyright: reportMissingImports=false

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")

from matplotlib import colormaps, pyplot
from matplotlib.figure import Figure

import softras2d as sr

from ..common import machine, report

HERE = Path(__file__).parent
PACKAGES = ("softras2d", "jax", "jaxlib", "numpy", "matplotlib")

SIZE, CELLS, JITTER_PX = 40, 5, 2.4

COVERAGES = {
    'Area("over")': sr.Area("over"),
    'Area("sum")': sr.Area("sum"),
    "Hard(16)": sr.Hard(16),
    "Soft(1.0)": sr.Soft(1.0),
}

MOST = 0.3
"""The difference at the end of the colour scale."""


def tiling() -> sr.Scene:
    """Triangles that share all edges and fill the canvas; neighbours have almost one colour."""
    rng = np.random.default_rng(0)
    side = np.linspace(0, SIZE, CELLS + 1)
    positions = np.stack(np.meshgrid(side, side), -1)
    positions[1:-1, 1:-1] += rng.uniform(-JITTER_PX, JITTER_PX, (CELLS - 1, CELLS - 1, 2))
    positions = positions.reshape(-1, 2).astype(np.float32)
    corner = np.arange(CELLS * (CELLS + 1)).reshape(CELLS, CELLS + 1)[:, :-1].ravel()
    a, b, c, d = corner, corner + 1, corner + CELLS + 2, corner + CELLS + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    centroid = positions[triangles].mean((1, 2)) / SIZE
    colors = colormaps["Blues"](0.95 - 0.6 * centroid)[:, :3]
    return sr.Scene.from_mesh(positions, triangles, triangle_colors=colors)


def draw(scene: sr.Scene, coverage: Any) -> np.ndarray:
    """Draw the image; return it in float64."""
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=coverage)
    return np.asarray(sr.render(scene, plan), np.float64)


def picture(images: dict[str, np.ndarray], reference: np.ndarray) -> Figure:
    """Draw the images, and below them their differences to the reference, on one colour scale."""
    figure, panels = pyplot.subplots(2, 5, figsize=(13, 5.6), layout="constrained")
    for axes in panels.flat:
        axes.set(xticks=[], yticks=[])
    panels[0, 0].imshow(reference)
    panels[0, 0].set_title("Hard(256)\nthe reference", fontsize=12)
    shades = None
    for (top, bottom), (name, image) in zip(panels.T[1:], images.items(), strict=True):
        off = np.abs(image - reference).max(2)
        top.imshow(np.clip(image, 0, 1))
        top.set_title(f"{name}\n", fontsize=12)
        shades = bottom.imshow(off, cmap="inferno", vmin=0, vmax=MOST)
        bottom.set_xlabel(f"at most {_most(off)}", fontsize=11)
    assert shades is not None
    key = panels[1, 0]
    key.axis("off")
    note = "This row: difference to\nthe reference, greatest\nof three channels"
    key.text(0, 0.8, note, fontsize=12)
    bar = key.inset_axes((0.0, 0.5, 0.9, 0.1))
    figure.colorbar(shades, cax=bar, orientation="horizontal")
    return figure


def _most(off: np.ndarray) -> str:
    return f"{np.abs(off).max():.3f}"


def main() -> None:
    scene = tiling()
    reference = draw(scene, sr.Hard(256))
    images = {name: draw(scene, coverage) for name, coverage in COVERAGES.items()}
    report.save_figure(picture(images, reference), HERE / "results" / "seams.png")
    rows = []
    for name, image in images.items():
        off = image - reference
        paper = f"{100 * np.mean(off.mean(2) > 0.05):.1f} %"
        rows.append([f"`{name}`", f"{np.sqrt((off**2).mean()):.4f}", _most(off), paper])
    header = ["coverage", "RMSE", "greatest error", "pixels lighter by more than 0.05"]
    report.fill_markers(HERE / "README.md", "errors", report.table(header, rows))
    run = {"machine": machine.record(PACKAGES), "precision": "float32"}
    report.fill_markers(HERE / "README.md", "machine", f"{machine.describe(run, seed='seed 0')}.")


if __name__ == "__main__":
    main()
