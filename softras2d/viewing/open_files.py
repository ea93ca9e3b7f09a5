"""Makes the subjects of the files that the command line names."""

from collections.abc import Sequence
from pathlib import Path

from ..fitting.result import FitResult
from .image import image_file
from .scene_file import ReadOptions, SceneFile
from .scene_in_memory import SceneInMemory
from .subject import FitState, Subject


def open_files(paths: Sequence[Path], options: ReadOptions) -> list[Subject]:
    """One subject for each file: SVG drawings, saved fits (`.npz`), and images.

    Drawings and images are read when they are shown, and again whenever they change.
    """
    return [_open(path, options) for path in paths]


def fit_subject(name: str, result: FitResult) -> SceneInMemory:
    """The scene of a fit, with the records of the fit."""
    return SceneInMemory(
        name, result.scene, result.height, result.width, FitState(tuple(result.history))
    )


def _open(path: Path, options: ReadOptions) -> Subject:
    suffix = path.suffix.lower()
    if suffix == ".svg":
        return SceneFile(path, options)
    if suffix == ".npz":
        return fit_subject(path.name, FitResult.load(path))
    return image_file(path)
