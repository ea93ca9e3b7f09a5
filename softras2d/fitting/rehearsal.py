"""Draw and score the scenes of a fit in another thread while it goes on, as its result will be."""

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType

import jax

from ..scene import Scene

_INTERVAL = 10.0
"""Time between two rehearsals, as a multiple of the time that one takes. They share the processor
with the fit."""

_LAST = 3.0
"""Seconds left of a fit in which no rehearsal begins, as a multiple of the time that one takes."""

_COMPILED = 3.0
"""A rehearsal that takes this many times as long as expected has compiled a program."""


class Rehearsal:
    """Scores scenes of a fit in another thread, for three reasons.

    - The first compiles the programs, beside the first steps.
    - They tell how many seconds to set aside for the end of the fit. If triangles outgrow the plan,
      another program is compiled long before the end.
    - They give the PSNR of what would be saved now, which the image of a step is not.

    Use it in a `with` block, whose end waits for the thread.

    - `warm_up()`: compiles the programs for the result; returns the seconds that they take.
    - `psnr(scene)`: draws a scene in pixels of the target, and scores it.
    """

    def __init__(self, warm_up: Callable[[], float], psnr: Callable[[Scene], float]):
        self._psnr = psnr
        self._pool = ThreadPoolExecutor(1)
        self._warming: Future[float] = self._pool.submit(warm_up)
        self._running: Future[tuple[float, float]] | None = None
        self._seconds: float | None = None
        self._ended = 0.0
        self.psnr = float("nan")

    def __enter__(self) -> "Rehearsal":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._pool.shutdown()

    def done(self) -> bool:
        """Whether it is known how long the end of the fit takes."""
        return self._warming.done()

    def result(self) -> float:
        """Seconds that the end of the fit takes. Raises what the programs raised."""
        seconds = self._warming.result()
        return seconds if self._seconds is None else max(seconds, self._seconds)

    def update(self, best_scene: Callable[[], Scene], seconds_left: float) -> None:
        """Collect the last rehearsal if it has ended, and begin another when one is due.

        None begins in the last `seconds_left` seconds of a fit, because the fit would wait for it.
        """
        if not self._warming.done():
            return
        if self._running is not None and self._running.done():
            self.psnr, self._seconds = self._running.result()
            self._running, self._ended = None, time.perf_counter()
        idle, needed = time.perf_counter() - self._ended, self.result()
        is_due = idle >= _INTERVAL * needed and not seconds_left < _LAST * needed
        if self._running is None and is_due:
            self._running = self._pool.submit(self._rehearse, best_scene())

    def _rehearse(self, scene: Scene) -> tuple[float, float]:
        """PSNR of a scene, and how long it took to score it."""
        with jax.enable_x64(False):
            psnr, seconds = self._timed(scene)
            if seconds > _COMPILED * self.result():
                psnr, seconds = self._timed(scene)
            return psnr, seconds

    def _timed(self, scene: Scene) -> tuple[float, float]:
        began = time.perf_counter()
        return self._psnr(scene), time.perf_counter() - began
