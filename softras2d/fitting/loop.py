"""The loop: chunks of steps within a budget, a record of each, and progress reports.

One loop serves `fit` and `fit_batch`: it advances a list of fits together, of which `fit` has one.
"""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..color import premultiply
from ..numerics.device import to_device
from ..scene import Scene
from .chunk import advance_fits
from .family import AbstractFit
from .result import Record
from .score import compare

_CHUNK_SECONDS = 0.5
"""Length of a chunk that a fit by `seconds` aims at: how long a user waits for Ctrl-C to act, and
between two reports."""

_LEAST_WORK = 10.0
"""How many times as long as measuring its image a chunk should take at least."""

_MIN_CHUNKS = 8
"""A fit of few steps has at least this many chunks: triangles are added between them."""

_CHECKPOINT_SECONDS = 30.0
"""Least number of seconds between two checkpoints."""

SCORING_SECONDS = 3.0
"""Seconds set aside for scoring a result, until it is known how long that takes."""


class Moment(NamedTuple):
    """What `report` is told about a running fit.

    - `record`: the last record.
    - `share`: how far the fit is, 0..1.
    - `seconds_left`: estimated time to the last step; NaN until it is known.
    - `triangles`: the largest number of triangles that the fit may have.
    - `scene()`: the best scene at the time of the call, in pixels of the target. All scenes of a
      fit have the same shapes: triangles not in use lie outside the canvas or have no area.
    """

    record: Record
    share: float
    seconds_left: float
    triangles: int
    scene: Callable[[], Scene]


class Budget(NamedTuple):
    """How long a fit may take: `steps` in all, or until `deadline`.

    - `steps`: those of a resumed fit included; None with a deadline.
    - `deadline`, `start`: on the clock of `time.perf_counter`; `start` is when this call began.
    - `scoring`: the seconds that come after the last step, once they are known.
    - `spent`: seconds of the fit that is resumed.
    - `guess`: the seconds to set aside until `scoring` is known.
    """

    steps: int | None
    deadline: float | None
    scoring: Future[float]
    start: float
    spent: float
    guess: float = SCORING_SECONDS

    def share(self, steps: int, compiled_at: float | None) -> float:
        """How far a fit is after `steps` steps, 0..1.

        `compiled_at`: when the first chunk ended, None before that. Compiling is no progress.
        """
        if self.steps is not None:
            return steps / self.steps if self.steps else 1.0
        passed = 0.0 if compiled_at is None else time.perf_counter() - compiled_at
        done = self.spent + passed
        return min(1.0, done / max(done + self.seconds_for_steps(), 1e-9))

    def seconds_for_steps(self) -> float:
        """Seconds left for steps, of a fit with a deadline."""
        assert self.deadline is not None
        scoring = self.scoring.result() if self.scoring.done() else self.guess
        return max(0.0, self.deadline - scoring - time.perf_counter())

    def seconds_left(self, steps: int, step_seconds: float) -> float:
        """Seconds to the last step, after `steps` steps that took `step_seconds` each."""
        if self.steps is None:
            return self.seconds_for_steps()
        return max(0, self.steps - steps) * step_seconds

    def seconds(self) -> float:
        """Seconds of the fit so far, those of the fit that it resumes included."""
        return self.spent + time.perf_counter() - self.start

    def next_steps(
        self, steps: int, max_steps: int, step_seconds: float | None, measure_seconds: float
    ) -> int:
        """Number of steps of the next chunk, after `steps` steps; at most `max_steps`.

        - `step_seconds`: how long a step takes; None until it is known.
        - `measure_seconds`: how long it takes to measure the image after a chunk.
        """
        if self.steps is not None:
            return min(max_steps, -(-self.steps // _MIN_CHUNKS), self.steps - steps)
        if step_seconds is None:
            return 1
        wanted = max(_CHUNK_SECONDS, _LEAST_WORK * measure_seconds)
        return int(np.clip(min(wanted, self.seconds_for_steps()) / step_seconds, 1, max_steps))


class AcceptedSteps:
    """Counts the steps of a fit whose loss is lower than all losses before it in this call."""

    def __init__(self, before: int):
        self._accepted = before
        self._least = np.inf

    def add(self, losses: Float[np.ndarray, " steps"]) -> int:
        """Count the accepted steps of a chunk; return their number so far."""
        for loss in losses[np.isfinite(losses)]:
            self._accepted += bool(loss < self._least)
            self._least = min(self._least, loss)
        return self._accepted


def run(
    fits: Sequence[AbstractFit],
    histories: Sequence[list[Record]],
    budget: Budget,
    *,
    steps: int,
    max_steps: int,
    stop: Callable[[], bool],
    report: Callable[[float, float], None] | None = None,
    save: Callable[[], None] | None = None,
) -> bool:
    """Advance fits together to the end of the budget; return whether they were interrupted.

    - `histories`: one for each fit, to which a record is appended after each chunk.
    - `steps`: those taken before; `max_steps`: the largest number of steps of a chunk.
    - `stop()`: whether Ctrl-C was pressed; asked before each chunk.
    - `report(share, seconds_left)`: called after each chunk. A `KeyboardInterrupt` from it counts
      as Ctrl-C; any other exception is passed on.
    - `save()`: writes a checkpoint; called every half minute.
    """
    counters = [AcceptedSteps(past[-1].accepted if past else 0) for past in histories]
    compiled_at: float | None = None
    step_seconds: float | None = None
    measure_seconds = 0.0
    saved_at = time.perf_counter()
    while budget.share(steps, compiled_at) < 1:
        if stop():
            return True
        number = budget.next_steps(steps, max_steps, step_seconds, measure_seconds)
        began = time.perf_counter()
        for fit in fits:
            fit.refine(budget.share(steps, compiled_at))
        losses = advance_fits(fits, number, max_steps)
        now = time.perf_counter()
        # The first chunk compiles, so it does not tell how long a step takes.
        step_seconds = (now - began) / len(losses[0]) if compiled_at else None
        steps += len(losses[0])
        for fit, history, counter, own_losses in zip(
            fits, histories, counters, losses, strict=True
        ):
            accepted, (psnr, ssim) = counter.add(own_losses), measure(fit)
            record = Record(steps, budget.seconds(), psnr, ssim, accepted, fit.active)
            history.append(record)
        if compiled_at:
            measure_seconds = time.perf_counter() - now
        compiled_at = compiled_at or now
        if report is not None:
            left = budget.seconds_left(steps, step_seconds or np.nan)
            try:
                report(budget.share(steps, compiled_at), left)
            except KeyboardInterrupt:
                return True
        if save is not None and time.perf_counter() - saved_at > _CHECKPOINT_SECONDS:
            save()
            saved_at = time.perf_counter()
    return False


def measure(fit: AbstractFit) -> tuple[float, float]:
    """PSNR and SSIM, in display light, of the image that the last step saw."""
    image, target = (
        premultiply(to_device(array, np.float32)) for array in (fit.image, fit.request.target.image)
    )
    return compare(image, target)
