"""A subject that follows a fit while it runs."""

import threading

from ..fitting.loop import ProgressReport
from ..fitting.result import FitResult, Record
from ..scene import Scene
from .scene_in_memory import SceneInMemory
from .subject import FitState


class WatchedFit(SceneInMemory):
    """The best scene of a fit so far. `add` and `finish` are called by the thread of the fit.

    Another thread draws the scenes, with `scene_at`.
    """

    may_change = True

    def __init__(self, name: str, height: int, width: int):
        empty = Scene.from_soup([], [])
        super().__init__(name, empty, height, width, FitState((), is_running=True))
        self._records: list[Record] = []
        self._has_drawn = threading.Condition()
        self._drawn_version = 0
        self._is_watched = False

    def add(self, report: ProgressReport) -> None:
        """Show the state of the fit after a chunk of steps.

        While nobody looks at the last state, the next ones are only recorded, so that the fit does
        not wait for pictures that are never shown.
        """
        self._records.append(report.record)
        if self._version == 1 or self._drawn_version == self._version:
            self._show(report.scene(), is_running=True)

    def finish(self, result: FitResult, seconds: int | float) -> None:
        """Show the result, and wait for up to some seconds until a page has drawn it.

        Returns at once if no page shows the fit: none is open, or all show other subjects.
        """
        self._records = list(result.history)
        self._show(result.scene, is_running=False)
        with self._has_drawn:
            if self._is_watched:
                self._has_drawn.wait_for(self._is_drawn, seconds)

    def scene_at(self, zoom: int | float) -> Scene:
        """The scene so far, with its positions multiplied by the zoom."""
        version = self._version
        scene = super().scene_at(zoom)
        with self._has_drawn:
            self._drawn_version = version
            self._has_drawn.notify_all()
        return scene

    def watch(self, is_watched: bool) -> None:
        """Tell the fit whether a page shows it at the moment."""
        with self._has_drawn:
            self._is_watched = is_watched
            self._has_drawn.notify_all()

    def _is_drawn(self) -> bool:
        """Whether nothing is left to wait for."""
        return self._drawn_version == self._version or not self._is_watched

    def _show(self, scene: Scene, *, is_running: bool) -> None:
        self.replace(scene, FitState(tuple(self._records), is_running))
