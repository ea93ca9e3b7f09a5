"""A subject that follows a fit while it runs."""

import threading

from ..fitting.loop import ProgressReport
from ..fitting.result import FitResult, Record
from ..scene import Scene
from .scene_in_memory import SceneInMemory
from .subject import FitState


class WatchedFit(SceneInMemory):
    """The best scene of a fit so far. `add` and `finish` are called by the thread of the fit."""

    def __init__(self, name: str, height: int, width: int):
        empty = Scene.from_soup([], [])
        super().__init__(name, empty, height, width, FitState((), is_running=True))
        self._records: list[Record] = []
        self._is_seen = threading.Event()
        self._is_watched = False

    def add(self, report: ProgressReport) -> None:
        """Show the state of the fit after a chunk of steps.

        While nobody looks at the last state, the next ones are only recorded, so that the fit does
        not wait for pictures that are never shown.
        """
        self._records.append(report.record)
        if self._version == 1 or self._is_seen.is_set():
            self._show(report.scene(), is_running=True)

    def finish(self, result: FitResult, seconds: int | float) -> None:
        """Show the result, and wait for up to some seconds until a page has drawn it.

        Returns at once if no page has looked at the fit.
        """
        self._records = list(result.history)
        self._show(result.scene, is_running=False)
        if self._is_watched:
            self._is_seen.wait(seconds)

    def scene_at(self, zoom: int | float) -> Scene:
        """The scene so far, with its positions multiplied by the zoom."""
        scene = super().scene_at(zoom)
        self._is_watched = True
        self._is_seen.set()
        return scene

    def _show(self, scene: Scene, *, is_running: bool) -> None:
        self._is_seen.clear()
        self.replace(scene, FitState(tuple(self._records), is_running))
