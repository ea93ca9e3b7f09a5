"""How long a fit may take, in steps or in seconds, and how much of that time is used."""

import time
from typing import NamedTuple, Protocol

import numpy as np

DEFAULT_STEPS = 1000
"""Number of steps of a fit for which the user gives neither `steps` nor `seconds`."""

END_SECONDS = 3.0
"""Seconds reserved for the end of a fit, until its duration is known.

At its end, a fit solves for colours if asked to, and draws and scores its result."""

MAX_START_SHARE = 0.35
"""Share of the time limit `seconds` after which the search for initial triangles ends.

The fit then starts from the triangles that the search has so far. The search for a mesh may go on
until the fit's program is compiled (`mesh.early_program`)."""

_CHUNK_SECONDS = 0.5
"""Intended duration of a chunk of steps, in seconds, if the fit has a time limit.

For about this long a user waits for Ctrl-C to act, and for the next progress report."""

_CHUNK_PER_MEASUREMENT = 10.0
"""Least duration of a chunk of steps, if the fit has a time limit, as a multiple of the time that
computing the PSNR and SSIM after the chunk takes."""

_MIN_CHUNKS = 8
"""Divisor of a limit of steps; the quotient, rounded up, is the largest number of steps of a chunk.

Triangles are added between chunks, so there must be several chunks."""


class Limits(NamedTuple):
    """The limit of a call of `fit`: a number of steps, or a point in time.

    - `began`: when the call began, in seconds on the clock of `time.perf_counter`.
    - `steps`: largest total number of steps, including the steps of a fit that is resumed; None if
      there is a deadline.
    - `deadline`: when the call must end, on the same clock; None if `steps` is the limit.
    """

    began: float
    steps: int | None
    deadline: float | None

    @staticmethod
    def of(began: float, steps: int | None, seconds: int | float | None) -> "Limits":
        """Make the limits of a call from the arguments `steps` and `seconds` of `fit`.

        At most one of these arguments is given. If neither is, the limit is `DEFAULT_STEPS` steps.
        `began`: when the call began, in seconds on the clock of `time.perf_counter`.
        """
        if seconds is None:
            return Limits(began, DEFAULT_STEPS if steps is None else steps, None)
        return Limits(began, None, began + seconds)

    def must_start(self) -> bool:
        """Whether the share `MAX_START_SHARE` of the time limit has passed since the call began.

        The search for initial triangles should then end. Always False if there is no deadline.
        """
        if self.deadline is None:
            return False
        seconds = self.deadline - self.began
        return time.perf_counter() - self.began > MAX_START_SHARE * seconds


class Estimate(Protocol):
    """A duration in seconds that becomes known later: a `Future[float]` or a `Rehearsal`."""

    def done(self) -> bool:
        """Whether the duration is known."""
        ...

    def result(self) -> float:
        """The duration in seconds; waits until it is known."""
        ...


class Budget(NamedTuple):
    """The limit of a fit, and functions that tell how much of it is used.

    - `limits`: the limit, a number of steps or a deadline.
    - `end_seconds`: the seconds that the end of the fit takes, in which it solves for colours, and
      draws and scores its result.
    - `seconds_before`: seconds that the resumed fit took; 0 for a new fit.
    - `end_guess`: the seconds to reserve for the end of the fit until `end_seconds` is known.
    """

    limits: Limits
    end_seconds: Estimate
    seconds_before: float
    end_guess: float = END_SECONDS

    def share(self, steps: int, compiled_at: float | None) -> float:
        """Share of the fit that is done after a total of `steps` steps, from 0; at 1 it is done.

        If the limit is a number of steps, the share is `steps` divided by the limit, or 1 if the
        limit is 0. It exceeds 1 if the resumed fit took more steps than the limit.

        If the limit is a deadline, the share is t / (t + r), where t is the time used and r the
        time left for steps. It is 0 if both are 0, so that a new fit takes at least one chunk. The
        time used is that of the resumed fit plus the time since `compiled_at`. The time left does
        not include the seconds that are reserved for the end of the fit.

        `compiled_at`: when the first chunk of this call ended, on the clock of `time.perf_counter`;
        None before that.
        """
        if self.limits.steps is not None:
            return steps / self.limits.steps if self.limits.steps else 1.0
        elapsed = 0.0 if compiled_at is None else time.perf_counter() - compiled_at
        done = self.seconds_before + elapsed
        return min(1.0, done / max(done + self._seconds_for_steps(), 1e-9))

    def seconds_left(self, steps: int, step_seconds: float) -> float:
        """Estimate the seconds until the last step, after a total of `steps` steps.

        `step_seconds`: how long a step takes; NaN if not known, which makes the result NaN. It is
        used only if the limit is a number of steps.
        """
        if self.limits.steps is None:
            return self._seconds_for_steps()
        return max(0, self.limits.steps - steps) * step_seconds

    def seconds(self) -> float:
        """Seconds that this call and the fit that it resumes have taken so far."""
        return self.seconds_before + time.perf_counter() - self.limits.began

    def next_steps(
        self, steps: int, max_steps: int, step_seconds: float | None, measure_seconds: float
    ) -> int:
        """Number of steps of the next chunk, after a total of `steps` steps; at most `max_steps`.

        If the limit is a number of steps, a chunk has at most an eighth of it (`_MIN_CHUNKS`),
        rounded up, and no more than the steps that are left. If it is a deadline, a chunk should
        take half a second or ten times `measure_seconds`, whichever is longer, but no longer than
        the time that is left for steps. It has at least one step.

        - `step_seconds`: how long a step takes; None if it is not known, which makes the result 1
          if there is a deadline.
        - `measure_seconds`: how long the PSNR and SSIM of the image take to compute after a chunk.
        """
        if self.limits.steps is not None:
            chunk = -(-self.limits.steps // _MIN_CHUNKS)
            return min(max_steps, chunk, self.limits.steps - steps)
        if step_seconds is None:
            return 1
        seconds = max(_CHUNK_SECONDS, _CHUNK_PER_MEASUREMENT * measure_seconds)
        return int(np.clip(min(seconds, self._seconds_for_steps()) / step_seconds, 1, max_steps))

    def _seconds_for_steps(self) -> float:
        """Seconds that remain for steps before the deadline.

        The limit must be a deadline. The seconds that are reserved for the end of the fit are
        subtracted. The result is 0 or more.
        """
        assert self.limits.deadline is not None
        seconds = self.end_seconds.result() if self.end_seconds.done() else self.end_guess
        return max(0.0, self.limits.deadline - seconds - time.perf_counter())
