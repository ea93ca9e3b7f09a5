"""Where `softras2d fit` starts: a word, or a scene in a file. Imports JAX: for use in a command."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..fitting.choices import STARTS
from ..fitting.frame import Frame
from ..fitting.mesh.triangulation import Mesh, make_mesh
from ..fitting.result import FitResult
from ..io.svg.reader import read_svg
from ..numerics.device import to_device
from ..scene import Scene


def read_start(text: str, family: str, size: int | None, height: int, width: int) -> Any:
    """What `fit` takes as its start for a target of that height and width, fitted at `size`.

    An SVG is drawn to the size of the target, a fit saved as `.npz` is stretched to it. Raises
    `ValueError` for what is none of these.
    """
    if text in STARTS:
        return text
    path = Path(text)
    suffix = path.suffix.lower()
    if suffix == ".svg" and family == "layers":
        return read_svg(path, height=height, width=width)
    if suffix != ".npz":
        known = "an .npz" if family == "mesh" else "an .svg or .npz"
        raise ValueError(f"--start must be one of {', '.join(STARTS)}, or {known}; got {text!r}.")
    earlier = FitResult.load(path)
    own = earlier.settings["family"]
    if own != family:
        raise ValueError(f"{path}: that is a fit of {own}, and --family is {family}.")
    if family == "mesh":
        return _mesh(earlier, Frame.of(height, width, {"family": family, "size": size}))
    return _stretched(earlier.scene, width / earlier.width, height / earlier.height)


def _mesh(earlier: FitResult, frame: Frame) -> Mesh:
    """In pixels of the fit; what is on the border but for a rounding of float32 is put there."""
    whole = np.array([earlier.width, earlier.height], np.float64)
    share = np.asarray(earlier.scene.positions, np.float64) / whole
    share = np.where(np.abs(share - 1) < 1e-6, 1.0, share)
    positions = share * [frame.width, frame.height]
    triangles = np.asarray(earlier.scene.triangles)
    return make_mesh(positions, triangles, height=frame.height, width=frame.width)


def _stretched(scene: Scene, across: float, down: float) -> Scene:
    positions = np.asarray(scene.positions) * np.array([[across, down]], np.float32)
    return replace(scene, positions=to_device(positions))
