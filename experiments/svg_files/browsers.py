"""Compare images of real SVG files with Chromium's pictures of the same files.

python -m experiments.svg_files.browsers
"""

from pathlib import Path
from typing import Any

import numpy as np

import softras2d as sr
from softras2d.comparison.screenshot import FAR_LEVELS, screenshot
from softras2d.comparison.similarity import psnr
from softras2d.io.svg.reading.reader import svg_size
from tests.cases.browser import require_browser

from ..common import machine, report

HERE = Path(__file__).parent
DRAWINGS = sorted((HERE / "drawings").glob("*.svg"))
PACKAGES = ("softras2d", "jax", "numpy", "shapely", "fonttools", "tinycss2", "cssselect2")


def measure(path: Path, browser: str) -> tuple[dict[str, Any], np.ndarray]:
    """Draw a file; return a row, and the package's image, Chromium's and the difference in one."""
    height, width = (2 * side for side in svg_size(path))
    scene = sr.read_svg(path, height=height, width=width)
    plan = sr.plan(scene, height=height, width=width, coverage=sr.Hard(samples=16))
    ours = np.clip(np.asarray(sr.render(scene, plan))[..., :3], 0.0, 1.0)
    theirs = screenshot(browser, path, height=height, width=width)
    difference = np.abs(ours - theirs)
    row = {
        "drawing": path.stem,
        "triangles": scene.triangles.shape[0],
        "psnr": float(psnr(ours, theirs)),
        "far": 100 * float((255 * difference.max(axis=-1) > FAR_LEVELS).mean()),
    }
    gap = np.ones((height, 8, 3), np.float32)
    pictures = [ours, gap, theirs, gap, 1.0 - np.clip(4 * difference, 0.0, 1.0)]
    return row, np.concatenate(pictures, axis=1)


def main() -> None:
    browser = require_browser()
    rows = []
    for path in DRAWINGS:
        row, picture = measure(path, browser)
        rows.append(row)
        print(row, flush=True)
        sr.write_image(HERE / "results" / f"{path.stem}.png", picture)
    report.write_csv(HERE / "results" / "browsers.csv", rows)
    header = [
        "drawing",
        "triangles",
        "PSNR, dB",
        f"pixels that differ by over {FAR_LEVELS} of 255, %",
    ]
    lines = [
        [row["drawing"], f"{row['triangles']:,}", f"{row['psnr']:.1f}", f"{row['far']:.2f}"]
        for row in rows
    ]
    report.fill_markers(HERE / "README.md", "browsers", report.table(header, lines))
    run = {"machine": machine.record(PACKAGES), "precision": "float32"}
    report.fill_markers(HERE / "README.md", "machine", f"{machine.describe(run, seed='no seed')}.")


if __name__ == "__main__":
    main()
