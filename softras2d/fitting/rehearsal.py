"""Draw and score scenes of a running fit in another thread, as its result will be at the end.

A *rehearsal* is to draw and score one scene. The *end of the fit* is the time after the last step,
in which the result is made.
"""

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType

import jax

from ..scene import Scene

_INTERVAL = 10.0
"""Least time between two rehearsals, as a multiple of the time that the end of the fit takes.

`Rehearsal` draws and scores scenes while the fit runs. It shares the processor with the fit, so
rehearsals must be rare."""

_LEAST_TIME_LEFT = 3.0
"""Least time until the last step at which a rehearsal may still begin, as a multiple of the time
that the end of the fit takes.

A rehearsal that begins later would delay the end."""

_COMPILED_TIME_FACTOR = 3.0
"""Multiple of the expected duration of a rehearsal.

A rehearsal that takes longer must have compiled a program, so its duration is measured again."""


class Rehearsal:
    """Draws and scores scenes of a running fit in another thread, as its result will be at the end.

    This has three purposes:

    - The programs that make the result are compiled while the first steps run. If the scenes
      outgrow the plan for scoring, another program is compiled long before the end.
    - The fit learns how many seconds to reserve for its end: `result()`.
    - The attribute `psnr` is about the PSNR, in dB, that the result would have if the fit ended
      now. It is the PSNR of the last scene that was scored, and NaN before the first. The PSNR of
      the image of a step differs from it, because that image has another size and coverage.

    Use it in a `with` block, whose end waits for the thread. The arguments are functions:

    - `warm_up()`: compiles the programs for the result; returns the seconds that they take after
      compilation.
    - `psnr(scene)`: draws a scene, in pixels of the target, and returns its PSNR in dB.
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
        """Whether the duration of the end of the fit is known, because `warm_up` has ended."""
        return self._warming.done()

    def result(self) -> float:
        """Seconds that the end of the fit takes; waits until they are known.

        They are those that `warm_up` returned, or those of the last rehearsal if it took longer.
        Raises any exception that `warm_up` raised.
        """
        seconds = self._warming.result()
        return seconds if self._seconds is None else max(seconds, self._seconds)

    def update(self, best_scene: Callable[[], Scene], seconds_left: float) -> None:
        """Collect the last rehearsal if it has ended, and begin another one when it is due.

        - `best_scene()`: returns the scene to score, in pixels of the target.
        - `seconds_left`: seconds until the last step; NaN if not known. No rehearsal begins shortly
          before the last step, because the fit would wait for it.

        Nothing is done before `warm_up` has ended.
        """
        if not self._warming.done():
            return
        if self._running is not None and self._running.done():
            self.psnr, self._seconds = self._running.result()
            self._running, self._ended = None, time.perf_counter()
        idle, needed = time.perf_counter() - self._ended, self.result()
        is_due = idle >= _INTERVAL * needed and not seconds_left < _LEAST_TIME_LEFT * needed
        if self._running is None and is_due:
            self._running = self._pool.submit(self._rehearse, best_scene())

    def _rehearse(self, scene: Scene) -> tuple[float, float]:
        """Return the PSNR of a scene, in dB, and the seconds of scoring it without compiling.

        If the first try seems to have compiled a program, a second one is timed.
        """
        with jax.enable_x64(False):
            psnr, seconds = self._timed(scene)
            if seconds > _COMPILED_TIME_FACTOR * self.result():
                psnr, seconds = self._timed(scene)
            return psnr, seconds

    def _timed(self, scene: Scene) -> tuple[float, float]:
        """Return the PSNR of a scene, in dB, and the seconds of scoring it."""
        began = time.perf_counter()
        return self._psnr(scene), time.perf_counter() - began
