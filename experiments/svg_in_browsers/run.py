"""Compare SVG files of fits in Chromium with the image that the package draws.

python -m experiments.svg_in_browsers.run FOLDER
"""

import argparse
import re
from pathlib import Path
from typing import Any

import numpy as np

import softras2d as sr
from softras2d.comparison.screenshot import screenshot
from softras2d.comparison.similarity import psnr
from softras2d.io.svg.writing.browser_gradients import in_browsers
from tests.cases.browser import require_browser

from ..common import machine, report

HERE = Path(__file__).parent
CACHE = HERE / "cache"
PACKAGES = ("softras2d", "jax", "jaxlib", "numpy")

SECONDS = 15

FLAT_MESH = {"family": "mesh", "shading": "flat", "colors": "solve"}

FITS: dict[str, tuple[str, dict[str, Any]]] = {
    "flat layers, 100": ("kodim23", {"triangles": 100}),
    "flat layers, 1,000": ("kodim23", {"triangles": 1000}),
    "translucent layers, 300": ("kodim23", {"triangles": 300, "translucent": True}),
    "interpolated layers, 300": ("kodim23", {"triangles": 300, "shading": "gouraud", "steps": 400}),
    "flat mesh, 1,000": ("kodim23", {"triangles": 1000, **FLAT_MESH}),
    "flat mesh, 10,000": ("kodim05", {"triangles": 10000, **FLAT_MESH}),
    "interpolated mesh, 1,000": ("kodim23", {"triangles": 1000, "family": "mesh"}),
    "interpolated mesh, 10,000": ("kodim05", {"triangles": 10000, "family": "mesh"}),
}


def fitted(name: str, folder: Path) -> sr.FitResult:
    """The fit of a row, read from the cache if the cache has it."""
    cached = CACHE / f"{re.sub('[^a-z0-9]+', '_', name)}.npz"
    if not cached.exists():
        picture, options = FITS[name]
        budget = {} if "steps" in options else {"seconds": SECONDS}
        image = sr.read_image(folder / f"{picture}.png")
        cached.parent.mkdir(exist_ok=True)
        sr.fit(image, seed=0, **budget, **options).save(cached)
    return sr.FitResult.load(cached)


def polygons_alone(path: Path) -> str:
    """Text of a written file whose fallback is flat polygons, without gradients and seam lines."""
    text = re.sub(r"<(style|defs|g) data-fallback.*?</\1>\n", "", path.read_text(), flags=re.DOTALL)
    text = re.sub(r"<path data-fallback.*\n", "", text)
    text = re.sub(r'</?g( class="softras2d-tiling")?>\n', "", text)
    return re.sub(r'<colortri points="(.*?)" colors="(.*?)"/>', _mean_polygon, text)


def _mean_polygon(match: re.Match[str]) -> str:
    colors = np.array(match[2].split(), float).reshape(3, 4)
    red, green, blue, alpha = (100 * colors.mean(axis=0)).round(1)
    # No antialiasing, so that no seams show between neighbours.
    return (
        f'<polygon data-fallback="1" shape-rendering="crispEdges" points="{match[1]}" '
        f'fill="rgb({red}% {green}% {blue}%)" fill-opacity="{alpha / 100:g}"/>\n{match[0]}'
    )


def measure(name: str, folder: Path, browser: str) -> dict[str, Any]:
    """A row: PSNR, in dB, of Chromium's pictures against the fit's image, and file sizes."""
    result = fitted(name, folder)
    height, width = result.height, result.width
    reference = np.clip(result.image[..., :3], 0.0, 1.0)
    path = CACHE / "scene.svg"
    sr.write_svg(path, result.scene, height=height, width=width, fallback=True)
    written = path.read_text()
    files = {
        "polygons": polygons_alone(path),
        "no_blend_modes": written.replace("mix-blend-mode", "no-such-property"),
        "written": written,
    }
    row: dict[str, Any] = {"scene": name, "triangles": result.scene.triangles.shape[0]}
    for kind, text in files.items():
        path.write_text(text)
        shown = screenshot(browser, path, height=height, width=width)
        row[f"{kind}_db"] = float(psnr(shown, reference))
    expected = in_browsers(result.scene)
    row["estimate_db"] = float("inf")
    if expected is not result.scene:
        plan = sr.plan(expected, height=height, width=width, coverage=sr.Hard(samples=16))
        image = np.asarray(sr.render(expected, plan))
        row["estimate_db"] = float(psnr(np.clip(image[..., :3], 0.0, 1.0), reference))
    row["polygons_kb"] = len(files["polygons"]) / 1000
    row["written_kb"] = len(written) / 1000
    return row


def main() -> None:
    parser = argparse.ArgumentParser(
        description="Compare Chromium's pictures of fits with the images of the fits."
    )
    parser.add_argument("folder", type=Path, help="Folder with kodim05.png and kodim23.png.")
    folder = parser.parse_args().folder
    browser = require_browser()
    rows = []
    for name in FITS:
        rows.append(measure(name, folder, browser))
        print(rows[-1], flush=True)
    report.write_csv(HERE / "results" / "svg_in_browsers.csv", rows)
    header = [
        "scene", "polygons alone, dB", "without blend modes, dB", "as written, dB",
        "estimate, dB", "polygons alone, kB", "as written, kB",
    ]  # fmt: skip
    kinds = ("polygons_db", "no_blend_modes_db", "written_db", "estimate_db")
    lines = [
        [row["scene"]]
        + [f"{row[kind]:.1f}" if np.isfinite(row[kind]) else "same colours" for kind in kinds]
        + [f"{row[kind]:,.0f}" for kind in ("polygons_kb", "written_kb")]
        for row in rows
    ]
    report.fill_markers(HERE / "README.md", "table", report.table(header, lines))
    run = {"machine": machine.record(PACKAGES), "precision": "float32"}
    report.fill_markers(HERE / "README.md", "machine", f"{machine.describe(run, seed='seed 0')}.")


if __name__ == "__main__":
    main()
