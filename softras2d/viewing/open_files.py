"""Makes the subjects of files that the command line or a notebook names.

A subject is a drawing or an image that the viewer shows (`subject.py`).
"""

from collections.abc import Sequence
from pathlib import Path

from ..fitting.result import FitResult
from .image import ImageCache, image_file
from .scene_file import ReadOptions, SceneFile
from .scene_in_memory import SceneInMemory
from .subject import FitState, Subject


def open_files(paths: Sequence[Path], options: ReadOptions) -> list[Subject]:
    """Make one subject for each file: an SVG drawing, a saved fit (`.npz`), or an image.

    Drawings and images are read when they are shown, and again whenever they change. A saved fit is
    read now, and not again. The suffix decides the kind of a file; any file that is neither `.svg`,
    `.svgz` nor `.npz` is taken for an image. `options` say how SVG files are read.
    """
    cache = ImageCache()
    return [_open(path, options, cache) for path in paths]


def fit_subject(name: str, result: FitResult, source: str = "") -> SceneInMemory:
    """Make a subject, which the viewer can show, of the scene and the history of a finished fit.

    `name` is what a page calls it. `source` is as in `SceneInMemory`.
    """
    state = FitState(tuple(result.history))
    return SceneInMemory(name, result.scene, result.height, result.width, state, source)


def _open(path: Path, options: ReadOptions, cache: ImageCache) -> Subject:
    """Make the subject of one file, whose suffix decides its kind, as in `open_files`.

    `options` apply to an SVG file; an image file uses the `cache`.
    """
    suffix = path.suffix.lower()
    if suffix in (".svg", ".svgz"):
        return SceneFile(path, options)
    if suffix == ".npz":
        source = f"scene = sr.FitResult.load({str(path)!r}).scene\n"
        return fit_subject(path.name, FitResult.load(path), source)
    return image_file(path, cache)
