"""States the interface of a subject, which is a drawing or an image that the viewer shows."""

import abc
from collections import OrderedDict
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import UInt8

from ..fitting.result import Record
from ..scene import Scene
from .settings import Settings
from .view import View, enlarged_size

_MAX_CACHED_SCENES = 4
"""Number of enlarged scenes that a subject stores, for pages that show different zooms."""


class FitState(NamedTuple):
    """The progress of a fit: its records so far, and whether it still runs."""

    history: tuple[Record, ...]
    is_running: bool = False


class Subject(abc.ABC):
    """A drawing or an image that the viewer shows at any zoom.

    A subclass implements `scene_at` if it is made of triangles, and `pixels` if it is an image.

    - `name`: what a page calls the subject; several subjects may have the same name.
    - `is_image`: whether the subject is an image.
    - `may_change`: whether the contents may change while the subject is shown, for example because
      a file is edited.
    """

    is_image = False
    may_change = False

    def __init__(self, name: str):
        self.name = name

    @property
    @abc.abstractmethod
    def version(self) -> int:
        """A number that changes whenever the contents do."""

    @abc.abstractmethod
    def size(self) -> tuple[int, int]:
        """Height and width of the subject in pixels, at zoom 1.

        Raises `ValueError` if the subject cannot be read.
        """

    def scene_at(self, zoom: int | float) -> Scene:
        """The scene of the drawing, with positions in pixels of the drawing enlarged by `zoom`.

        Raises `ValueError` if the subject cannot be read, or is an image.
        """
        raise ValueError(f"{self.name} is an image, and has no triangles.")

    def pixels(self, view: View) -> UInt8[np.ndarray, "height width 4"]:
        """The part of the image that a view shows, as straight RGBA in sRGB.

        Raises `ValueError` if the subject cannot be read, or is not an image.
        """
        raise ValueError(f"{self.name} is made of triangles, and is not an image.")

    def command(self, view: View, settings: Settings) -> str:
        """The command line, or the Python code, that draws the same picture; empty for images."""
        return ""

    def notes(self) -> tuple[str, ...]:
        """Warnings from reading the subject, one line each."""
        return ()

    def watch(self, is_watched: bool) -> None:  # noqa: B027
        """Learn whether any page shows this subject now.

        The server calls it when a page requests the picture of the subject that it shows, rather
        than compares with, and when a page closes. `is_watched` is often the same as before.
        """

    def fit_state(self) -> FitState | None:
        """Progress of the fit whose scene this subject shows; None for other subjects."""
        return None


class SceneCache:
    """Cache of the last few scenes of a subject, by version of the subject and size in pixels."""

    def __init__(self):
        self._scenes: OrderedDict[tuple[int, int, int], Scene] = OrderedDict()

    def get(self, subject: Subject, zoom: int | float, make: Callable[[int, int], Scene]) -> Scene:
        """Return the scene of a subject at a zoom, which is made unless it is in the cache.

        `make(height, width)` makes the scene of the enlarged drawing, whose size is in pixels.
        """
        version = subject.version
        height, width = enlarged_size(*subject.size(), zoom)
        key = (version, height, width)
        if key not in self._scenes:
            self._scenes[key] = make(height, width)
            while len(self._scenes) > _MAX_CACHED_SCENES:
                self._scenes.popitem(last=False)
        self._scenes.move_to_end(key)
        return self._scenes[key]
