"""Reads the value of `--start`, a name or a file, as the argument `start` of `fit`.

This module imports JAX, so it is imported only while a command runs.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..fitting.choices import STARTS
from ..fitting.frame import Frame
from ..fitting.mesh.triangulation import Mesh, make_mesh
from ..fitting.result import FitResult
from ..fitting.traits import TRAITS
from ..io.svg.reading.reader import read_svg
from ..numerics.device import to_device
from ..scene import Scene


def read_start(text: str, family: str, size: int | None, height: int, width: int) -> Any:
    """Convert the text of the option `--start` to the argument `start` of `fit`.

    - `text`: a name, which is returned unchanged, or a file; `fit_paths.check_start` has checked
      it.
    - `family`: family of the new fit.
    - `size`: longer side of the image during the new fit, in pixels; None for the default.
    - `height`, `width`: size of the picture to fit, in pixels.

    An SVG file is read as a scene in pixels of the picture. The scene of a fit saved as `.npz` is
    stretched to the picture, so that it is in pixels of the picture too. For the family `mesh`, it
    is converted to a `Mesh` instead, in pixels of the image during the new fit. Raises `ValueError`
    for a file that cannot be read, and for a saved fit of another family.
    """
    if text in STARTS:
        return text
    path = Path(text)
    if path.suffix.lower() == ".svg":
        return read_svg(path, height=height, width=width)
    earlier = FitResult.load(path)
    saved_family = earlier.settings["family"]
    if saved_family != family:
        raise ValueError(f"{path}: a fit of family {saved_family}, but --family is {family}.")
    if family == "mesh":
        settings = {"family": family, "size": size or TRAITS[family].default_size}
        return _mesh(earlier, Frame.of(height, width, settings))
    return _stretched(earlier.scene, width / earlier.width, height / earlier.height)


def _mesh(earlier: FitResult, frame: Frame) -> Mesh:
    """Convert the scene of a saved fit to a mesh in pixels of the new fit, without its colours.

    `frame`: size of the new fit, in pixels, to which the positions are stretched. Vertices that lie
    beside the right or bottom border by a rounding error are moved exactly onto it.
    """
    canvas = np.array([earlier.width, earlier.height], np.float64)
    relative = np.asarray(earlier.scene.positions, np.float64) / canvas
    # A mesh must tile the canvas, and float32 positions are off by up to 1e-7 of its size.
    relative = np.where(np.abs(relative - 1) < 1e-6, 1.0, relative)
    positions = relative * [frame.width, frame.height]
    triangles = np.asarray(earlier.scene.triangles)
    return make_mesh(positions, triangles, height=frame.height, width=frame.width)


def _stretched(scene: Scene, x_scale: float, y_scale: float) -> Scene:
    """Multiply the x and the y of the positions of a scene by two factors."""
    positions = np.asarray(scene.positions) * np.array([[x_scale, y_scale]], np.float32)
    return replace(scene, positions=to_device(positions))
