"""How long a fit may take, in steps or in seconds, and how much of that is used."""

import time
from typing import NamedTuple, Protocol

import numpy as np

DEFAULT_STEPS = 1000
"""Steps of a fit that is given neither `steps` nor `seconds`."""

END_SECONDS = 3.0
"""Seconds set aside for the end of a fit, until it is known how long that takes."""

MAX_START_SHARE = 0.35
"""Share of the time limit `seconds` after which the search for a start ends with what it has."""

_CHUNK_SECONDS = 0.5
"""Target length of a chunk in a fit by `seconds`: how long a user waits for Ctrl-C to act, and
between two reports."""

_CHUNK_PER_MEASUREMENT = 10.0
"""Least duration of a chunk in a fit by `seconds`, as a multiple of the time that the PSNR and SSIM
of its image take."""

_MIN_CHUNKS = 8
"""A fit of few steps has at least this many chunks, because triangles are added between them."""


class Limits(NamedTuple):
    """How long a call of `fit` may take: a number of steps, or until a deadline.

    - `began`: when the call began, in seconds on the clock of `time.perf_counter`.
    - `steps`: largest number of steps, including the steps of a resumed fit; None with a deadline.
    - `deadline`: when the call must end, on the same clock; None if `steps` is the limit.
    """

    began: float
    steps: int | None
    deadline: float | None

    @staticmethod
    def of(began: float, steps: int | None, seconds: int | float | None) -> "Limits":
        """Make the limits of a call that began at `began`, from its options `steps` and `seconds`.

        At most one of them is given; if none is, the limit is `DEFAULT_STEPS`.
        """
        if seconds is None:
            return Limits(began, DEFAULT_STEPS if steps is None else steps, None)
        return Limits(began, None, began + seconds)

    def must_start(self) -> bool:
        """Whether the search for a start has taken so long that steps must begin.

        False without a deadline.
        """
        if self.deadline is None:
            return False
        seconds = self.deadline - self.began
        return time.perf_counter() - self.began > MAX_START_SHARE * seconds


class Estimate(Protocol):
    """Seconds that something will take, which become known later: a `Future`, or a `Rehearsal`."""

    def done(self) -> bool:
        """Whether the seconds are known."""
        ...

    def result(self) -> float:
        """The seconds; waits until they are known."""
        ...


class Budget(NamedTuple):
    """The limits of a fit, and how much of them is used.

    - `end_seconds`: the seconds that the end of the fit takes: solving for colours, and scoring.
    - `seconds_before`: seconds that the resumed fit took; 0 if there is none.
    - `end_guess`: the seconds to set aside until `end_seconds` is known.
    """

    limits: Limits
    end_seconds: Estimate
    seconds_before: float
    end_guess: float = END_SECONDS

    def share(self, steps: int, compiled_at: float | None) -> float:
        """Share of the fit that is done after `steps` steps, 0..1.

        With a deadline it is a share of the time for steps, in which the first chunk does not
        count, because it compiles. `compiled_at`: when the first chunk ended, on the clock of
        `time.perf_counter`; None before that.
        """
        if self.limits.steps is not None:
            return steps / self.limits.steps if self.limits.steps else 1.0
        elapsed = 0.0 if compiled_at is None else time.perf_counter() - compiled_at
        done = self.seconds_before + elapsed
        return min(1.0, done / max(done + self._seconds_for_steps(), 1e-9))

    def seconds_left(self, steps: int, step_seconds: float) -> float:
        """Estimated seconds to the last step, after `steps` steps.

        `step_seconds`: how long a step takes; NaN if not known. It is used only without a deadline.
        """
        if self.limits.steps is None:
            return self._seconds_for_steps()
        return max(0, self.limits.steps - steps) * step_seconds

    def seconds(self) -> float:
        """Seconds that the fit has taken so far, including the fit that it resumes."""
        return self.seconds_before + time.perf_counter() - self.limits.began

    def next_steps(
        self, steps: int, max_steps: int, step_seconds: float | None, measure_seconds: float
    ) -> int:
        """Number of steps of the next chunk, after `steps` steps; at most `max_steps`.

        - `step_seconds`: how long a step takes; None until it is known.
        - `measure_seconds`: how long the PSNR and SSIM of the image take after a chunk.
        """
        if self.limits.steps is not None:
            chunk = -(-self.limits.steps // _MIN_CHUNKS)
            return min(max_steps, chunk, self.limits.steps - steps)
        if step_seconds is None:
            return 1
        seconds = max(_CHUNK_SECONDS, _CHUNK_PER_MEASUREMENT * measure_seconds)
        return int(np.clip(min(seconds, self._seconds_for_steps()) / step_seconds, 1, max_steps))

    def _seconds_for_steps(self) -> float:
        """Seconds left for steps before the deadline, less the seconds set aside for the end."""
        assert self.limits.deadline is not None
        seconds = self.end_seconds.result() if self.end_seconds.done() else self.end_guess
        return max(0.0, self.limits.deadline - seconds - time.perf_counter())
