"""Shows scenes, fits, textures and images in a notebook, with the function `view`."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..fitting.result import FitResult
from ..io.pixel_values import as_pixels
from ..scene import Scene
from ..texture.pyramid import TexturePyramid
from .image import Image, pyramid_image
from .open_files import fit_subject, open_files
from .scene_file import ReadOptions
from .scene_in_memory import SceneInMemory, default_size
from .session import Session
from .subject import Subject

if TYPE_CHECKING:
    from .widget import ViewerWidget
else:
    # The type alone would import anywidget, which is optional.
    ViewerWidget = Any

_LEAST_WIDGET, _MOST_WIDGET = 200, 2000


def view(
    *subjects: Any,
    height: int | None = None,
    width: int | None = None,
    widget_height: int = 480,
) -> ViewerWidget:
    """Show scenes, fits, textures and images in a notebook, in an interactive viewer.

    In the viewer you can zoom, pan, switch settings, inspect pixels, and compare subjects.

    - `subjects`: one or several, of any kinds: a `Scene`, a `FitResult`, a `TexturePyramid`, an
      image `[height, width, 1, 3 or 4]` of floats in sRGB, 0..1, with straight alpha, or the path
      of an SVG file, an image or a saved fit. An image can be compared with the other subjects. It
      can also be the target of the gradients that the viewer draws over a scene. An SVG file or an
      image file is drawn again when it changes.
    - `height`, `width`: size of the canvas of each `Scene`, in pixels; by default the smallest
      canvas from (0, 0) that contains all triangles, at most 4096 pixels a side. Fits and SVG files
      have their own size.
    - `widget_height`: height of the widget on the screen, 200 to 2000 pixels.

    Returns the widget, which a notebook shows if it is the last value of a cell. Where no kernel
    runs, the widget shows a picture of the first subject. Press ? in the widget for a list of keys.
    If `softras2d.keep_compiled_programs()` was called, the first pictures of the next session
    compile nothing.

    Raises `ImportError`, with a message of one line, if anywidget is missing. Raises `ValueError`
    for no subjects, subjects of other kinds, batches of scenes, files that do not exist, and a
    `widget_height` outside its range.
    """
    if not _LEAST_WIDGET <= widget_height <= _MOST_WIDGET:
        raise ValueError(
            f"`widget_height` must be {_LEAST_WIDGET} to {_MOST_WIDGET}; got {widget_height!r}."
        )
    session = Session([_subject_of(given, at, height, width) for at, given in enumerate(subjects)])
    try:
        from .widget import ViewerWidget
    except ModuleNotFoundError as missing:
        raise ImportError(
            f'softras2d.view needs anywidget: pip install "softras2d[view]" ({missing}).'
        ) from missing
    return ViewerWidget(session, widget_height)


def _subject_of(given: Any, number: int, height: int | None, width: int | None) -> Subject:
    """Make the subject for one argument of `view`.

    - `given`: the argument.
    - `number`: its index among the subjects, from 0.
    - `height`, `width`: as in `view`; used for a `Scene` only.

    Raises `ValueError` for a batch of scenes, a file that does not exist, and an argument of
    another kind.
    """
    if isinstance(given, Scene):
        if np.ndim(given.positions) != 2:
            raise ValueError(f"subject {number} is a batch of scenes: give them one by one.")
        fitting = default_size(given)
        return SceneInMemory(
            f"scene {number + 1}",
            given,
            fitting[0] if height is None else height,
            fitting[1] if width is None else width,
        )
    if isinstance(given, FitResult):
        return fit_subject(f"fit {number + 1}", given)
    if isinstance(given, TexturePyramid):
        return pyramid_image(f"textures {number + 1}", given)
    if isinstance(given, str | os.PathLike):
        path = Path(given)
        if not path.is_file():
            raise ValueError(f"{path}: no such file.")
        return open_files([path], ReadOptions())[0]
    try:
        pixels = as_pixels(f"subject {number}", np.asarray(given))
    except (TypeError, ValueError) as error:
        raise ValueError(
            f"subject {number} must be a scene, a fit, a texture pyramid, an image or a path; got "
            f"{type(given).__name__} ({error})"
        ) from None
    return Image(f"image {number + 1}", lambda: pixels)
