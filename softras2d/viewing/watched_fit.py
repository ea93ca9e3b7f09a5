"""Defines the subject that shows a fit while it runs.

A subject is a drawing or an image that the viewer shows (`subject.py`). A page shows the subject
in a browser, and asks for its scene and its progress.
"""

import threading

from ..fitting.loop import ProgressReport
from ..fitting.result import FitResult, Record
from ..scene import Scene
from .scene_in_memory import SceneInMemory
from .subject import FitState


class WatchedFit(SceneInMemory):
    """A subject that shows a fit while it runs: the best scene so far, at one of its reports.

    Before the first progress report, the subject is empty. A later report changes the scene only if
    the scene that is shown has been drawn meanwhile. The thread of the fit calls `add` and
    `finish`. Other threads answer the pages: they call `watch`, read the progress with `fit_state`,
    and get the scene to draw from `scene_at`.

    - `name`: what a page calls the subject.
    - `height`, `width`: size of the picture that is fitted, in pixels.
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
        """Record a progress report, and show its scene if the last scene shown has been drawn.

        The scene of the first report is shown in any case.
        """
        self._records.append(report.record)
        if self._version == 1 or self._drawn_version == self._version:
            self._show(report.scene(), is_running=True)

    def finish(self, result: FitResult, seconds: int | float) -> None:
        """Show the result of the fit, and wait until a page shows it, for at most `seconds`.

        A page counts as showing the result once it was told that the fit has ended, and the last
        scene is being drawn. Returns at once if no page shows this subject.
        """
        self._records = list(result.history)
        self._show(result.scene, is_running=False)
        with self._has_shown:
            if self._is_watched:
                self._has_shown.wait_for(self._is_shown, seconds)

    def scene_at(self, zoom: int | float) -> Scene:
        """The scene that is shown now, enlarged by about `zoom` as in `SceneInMemory.scene_at`.

        From now on, this scene counts as drawn.
        """
        version = self._version
        scene = super().scene_at(zoom)
        with self._has_shown:
            self._drawn_version = version
            self._has_shown.notify_all()
        return scene

    def fit_state(self) -> FitState | None:
        """Progress of the fit so far. From now on, a page counts as told of it."""
        version = self._version
        state = super().fit_state()
        with self._has_shown:
            self._told_version = version
            self._has_shown.notify_all()
        return state

    def watch(self, is_watched: bool) -> None:
        """Record whether any page shows this subject now."""
        with self._has_shown:
            self._is_watched = is_watched
            self._has_shown.notify_all()

    def _is_shown(self) -> bool:
        """Whether a page shows the last progress and scene, or no page shows this subject."""
        # A request for an earlier scene may be answered with the last one, so that a picture alone
        # does not prove that a page knows that the fit has ended.
        is_shown = self._drawn_version == self._told_version == self._version
        return is_shown or not self._is_watched

    def _show(self, scene: Scene, *, is_running: bool) -> None:
        """Show a scene and the recorded progress from now on."""
        self.replace(scene, FitState(tuple(self._records), is_running))
