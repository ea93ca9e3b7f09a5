"""Starts the threads that all widgets of a process share: one draws, one watches for changes.

A subject is a drawing or an image that a widget shows. Its version is a number that changes
whenever its contents do.

The threads are shared because widgets accumulate: a notebook makes a widget each time that a cell
runs, and the front end keeps the old ones.
"""

import functools
import logging
import threading
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass

from .worker import Worker

_LOGGER = logging.getLogger(__name__)

_POLL_SECONDS = 0.5
"""Time, in seconds, between two checks whether subjects have changed."""


@functools.cache
def shared_worker() -> Worker:
    """Return the worker of all widgets, which starts at the first call."""
    return Worker()


@functools.cache
def shared_watcher() -> "Watcher":
    """Return the watcher of all widgets, which starts at the first call."""
    return Watcher(_POLL_SECONDS)


@dataclass
class _Watched:
    """Subjects whose versions are checked.

    - `versions`: returns the present version of each subject.
    - `last_versions`: the versions at the last check.
    - `tell`: called with the versions when they have changed.
    """

    versions: Callable[[], list[int]]
    last_versions: list[int]
    tell: Callable[[list[int]], None]

    def check(self) -> None:
        """Call `tell` if the versions have changed since the last check."""
        versions = self.versions()
        if versions != self.last_versions:
            self.last_versions = versions
            self.tell(versions)


class Watcher:
    """Checks the versions of subjects periodically, in a separate thread.

    - `seconds`: time between two checks.
    """

    def __init__(self, seconds: float):
        self._watched: dict[Hashable, _Watched] = {}
        self._seconds = seconds
        self._changed = threading.Condition()
        thread = threading.Thread(target=self._run, name="softras2d watcher", daemon=True)
        thread.start()

    def watch(
        self,
        owner: Hashable,
        versions: Callable[[], list[int]],
        tell: Callable[[list[int]], None],
    ) -> None:
        """Call `tell` with the result of `versions`, whenever the result has changed.

        `versions` returns the version of each subject. It is called once now, and then in the
        thread of the watcher, as `tell` is. If either function raises there, the error is logged,
        and neither is called again. `owner` is a key, with which `forget` stops the calls. If the
        functions of this owner are called already, nothing changes.
        """
        with self._changed:
            if owner not in self._watched:
                self._watched[owner] = _Watched(versions, versions(), tell)
                self._changed.notify()

    def forget(self, owner: Hashable) -> None:
        """Stop calling the functions that an owner has passed to `watch`.

        A check that has begun already may still call them.
        """
        with self._changed:
            self._watched.pop(owner, None)

    def _run(self) -> None:
        """Check all versions forever; sleep while nothing is watched."""
        while True:
            with self._changed:
                while not self._watched:
                    self._changed.wait()
                watched = list(self._watched.items())
            for owner, contents in watched:
                try:
                    contents.check()
                except Exception as error:
                    # A widget that fails must not end the thread, which serves others too.
                    reason = " ".join(str(error).split())[:300]
                    _LOGGER.error("changes are no longer watched for a widget: %s", reason)
                    self.forget(owner)
            time.sleep(self._seconds)
