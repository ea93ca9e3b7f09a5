"""Draw the README's picture: bundled scenes, and what 1, 4 and 16 samples make of a detail."""

from pathlib import Path

import numpy as np

import softras2d as sr
from softras2d import scenes
from softras2d.io.contact_sheet import Strip, contact_sheet

RESULTS = Path(__file__).parent / "results"
SIZE = 300
DETAILS = {"joints": (150, 60), "slivers": (120, 120), "wheel": (262, 120), "glass": (120, 90)}
"""Upper left corner (x, y) of the enlarged part of each scene."""
DETAIL_SIDE, ZOOM = 36, 8


def main() -> None:
    """Write `results/readme.png`."""
    strips = []
    for name, (x, y) in DETAILS.items():
        scene = scenes.read(name)
        images = {}
        for samples in (1, 4, 16):
            plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=sr.Hard(samples=samples))
            images[samples] = np.asarray(sr.render(scene, plan))
        details = [
            image[y : y + DETAIL_SIDE, x : x + DETAIL_SIDE].repeat(ZOOM, 0).repeat(ZOOM, 1)
            for image in images.values()
        ]
        captions = ["16 samples", "1 sample, x8", "4 samples, x8", "16 samples, x8"]
        strips.append(Strip(name, scenes.purpose(name), captions, [images[16], *details]))
    sr.write_image(RESULTS / "readme.png", contact_sheet(strips, across=1))


if __name__ == "__main__":
    main()
