"""A small target for tests of the fit, and the image that a mesh of the fit draws."""

import numpy as np

from softras2d.fitting.mesh.colors import (
    ColorModel,
    interpolate,
    mesh_pixels,
    to_corner_colors,
)
from softras2d.fitting.mesh.triangulation import Mesh


def blobs(height: int = 40, width: int = 48) -> np.ndarray:
    """A gradient with a disc and a box on it, `[height, width, 3]`."""
    y, x = np.mgrid[:height, :width] + 0.5
    image = np.stack([x / width, y / height, 0.5 + 0 * x], -1)
    image[(x - 15) ** 2 + (y - 14) ** 2 < 81] = [0.9, 0.2, 0.1]
    image[(np.abs(x - 34) < 7) & (np.abs(y - 27) < 9)] = [0.1, 0.3, 0.8]
    return image.astype(np.float32)


def draw(mesh: Mesh, colors: np.ndarray, *, model: ColorModel = "vertex") -> np.ndarray:
    """The image of a mesh, interpolated at pixel centres: float64 `[height, width, channels]`."""
    pairs = mesh_pixels(mesh)
    values = interpolate(pairs, to_corner_colors(mesh, colors, model))
    image = np.empty((mesh.height * mesh.width, len(values)))
    image[pairs.pixel] = values.T
    return image.reshape(mesh.height, mesh.width, -1)


def mean_psnr(target: np.ndarray) -> float:
    """PSNR, in dB, of an image that has the target's mean colour everywhere."""
    return float(-10 * np.log10(((target - target.mean((0, 1))) ** 2).mean()))
