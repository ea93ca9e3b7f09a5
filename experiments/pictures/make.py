"""Write the bundled pictures: `python -m experiments.pictures.make [FOLDER]`.

The files are in `softras2d/pictures`, and a test checks that this script still writes the same
files. Each picture is computed with 4 x 4 samples per pixel in linear light.
"""

import sys
from pathlib import Path

import numpy as np

from softras2d import pictures
from softras2d.color import linear_to_srgb
from softras2d.io.images import write_image

from .fruit import fruit
from .valley import valley

_SAMPLES = 4
"""Samples along each side of a pixel."""

_LIGHT = {"valley": valley, "fruit": fruit}


def make(name: str) -> np.ndarray:
    """A picture `[height, width, 3]` in 0..1, in sRGB."""
    fine = _LIGHT[name](_SAMPLES)
    height, width = fine.shape[0] // _SAMPLES, fine.shape[1] // _SAMPLES
    pixels = fine.reshape(height, _SAMPLES, width, _SAMPLES, 3).mean((1, 3))
    return np.clip(linear_to_srgb(pixels.astype(np.float32)), 0, 1)


def main() -> None:
    """Write all pictures into the given folder, or into the package if none is given."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else pictures.path("valley").parent
    folder.mkdir(parents=True, exist_ok=True)
    for name in pictures.names():
        write_image(folder / f"{name}.png", make(name))


if __name__ == "__main__":
    main()
