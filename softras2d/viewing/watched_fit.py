"""A subject that follows a fit while it runs."""

import threading

from ..fitting.loop import ProgressReport
from ..fitting.result import FitResult, Record
from ..scene import Scene
from .scene_in_memory import SceneInMemory
from .subject import FitState


class WatchedFit(SceneInMemory):
    """A fit that runs while pages show its best scene.

    The thread of the fit calls `add` and `finish`. Another thread answers the pages: it reads the
    progress by `fit_state`, and the scene to draw by `scene_at`.
    """

    may_change = True

    def __init__(self, name: str, height: int, width: int):
        empty = Scene.from_soup([], [])
        super().__init__(name, empty, height, width, FitState((), is_running=True))
        self._records: list[Record] = []
        self._has_shown = threading.Condition()
        self._drawn_version = self._told_version = 0
        self._is_watched = False

    def add(self, report: ProgressReport) -> None:
        """Record a chunk of steps, and show the best scene if the one before it has been drawn."""
        self._records.append(report.record)
        if self._version == 1 or self._drawn_version == self._version:
            self._show(report.scene(), is_running=True)

    def finish(self, result: FitResult, seconds: int | float) -> None:
        """Show the result, and wait until a page has it, for at most this many seconds.

        A page has it when it was told that the fit has ended, and the last scene is being drawn.

        Returns at once if no page shows the fit: none is open, or all show other subjects.
        """
        self._records = list(result.history)
        self._show(result.scene, is_running=False)
        with self._has_shown:
            if self._is_watched:
                self._has_shown.wait_for(self._is_shown, seconds)

    def scene_at(self, zoom: int | float) -> Scene:
        """The best scene so far, with its positions multiplied by the zoom; it counts as drawn."""
        version = self._version
        scene = super().scene_at(zoom)
        with self._has_shown:
            self._drawn_version = version
            self._has_shown.notify_all()
        return scene

    def fit_state(self) -> FitState | None:
        """The progress of the fit so far; notes that a page was told of it."""
        version = self._version
        state = super().fit_state()
        with self._has_shown:
            self._told_version = version
            self._has_shown.notify_all()
        return state

    def watch(self, is_watched: bool) -> None:
        """Tell the fit whether a page shows it at the moment."""
        with self._has_shown:
            self._is_watched = is_watched
            self._has_shown.notify_all()

    def _is_shown(self) -> bool:
        """Whether a page has the last state and scene, or no page shows the fit."""
        # A request for the scene before may be answered with this one, so a picture is not enough.
        is_shown = self._drawn_version == self._told_version == self._version
        return is_shown or not self._is_watched

    def _show(self, scene: Scene, *, is_running: bool) -> None:
        self.replace(scene, FitState(tuple(self._records), is_running))
