"""The loop: chunks of steps within a budget, a record of each, Ctrl-C with the best kept."""

import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np

from ..scene import Scene
from .loss import Loss
from .mesh_colors import Image
from .result import Record
from .score import ssim

_AIM = 0.5
"""Seconds that a chunk is to take: what a user waits for Ctrl-C, and sees between two figures."""

_SCORING = 3.0
"""Seconds set aside for the score while it is not known what it takes."""


@runtime_checkable
class Course(Protocol):
    """A fit of either family."""

    target: Image
    image: Image
    loss: Loss
    active: int

    def advance(self, steps: int, room: int) -> np.ndarray:
        """The losses of so many steps."""
        ...

    def refine(self, share: float) -> None:
        """What the host does between chunks, `share` of the way through the fit."""
        ...

    def scene(self, *, padded: bool = False) -> Scene:
        """The best so far, in pixels of the fit; `padded` to the size that it may reach."""
        ...


class Moment(NamedTuple):
    """What a user is shown of a fit: the last record, how far it is, and the scene on demand.

    `scene()` is in pixels of the target; triangles that wait for their use lie outside or have no
    area, so that all scenes of a fit have one size.
    """

    record: Record
    share: float
    scene: Callable[[], Scene]


class Budget(NamedTuple):
    """How long a fit may take: `steps` in all, or until `deadline`, as `time.perf_counter` has it.

    `scoring`: the seconds that come after the last step, as soon as they are known; `start`: when
    this call began; `spent`: seconds of the fit before that.
    """

    steps: int | None
    deadline: float | None
    scoring: Future[float]
    start: float
    spent: float

    def share(self, steps: int, began: float | None) -> float:
        """How far a fit is after so many steps, from 0 to 1; `began`: when the first was done."""
        if self.steps is not None:
            return steps / self.steps if self.steps else 1.0
        # What compiling takes is no part of the way.
        done = self.spent + (0.0 if began is None else time.perf_counter() - began)
        return min(1.0, done / max(done + self.left(), 1e-9))

    def left(self) -> float:
        """Seconds for steps."""
        assert self.deadline is not None
        scoring = self.scoring.result() if self.scoring.done() else _SCORING
        return max(0.0, self.deadline - scoring - time.perf_counter())

    def seconds(self) -> float:
        """Of the fit so far."""
        return self.spent + time.perf_counter() - self.start

    def next_steps(self, steps: int, room: int, pace: float | None) -> int:
        """Of the chunk that comes next; `pace` is the seconds that a step takes, once known."""
        if self.steps is not None:
            return min(room, self.steps - steps)
        if pace is None:
            return 1
        return int(np.clip(min(_AIM, self.left()) / pace, 1, room))


def run(
    course: Course,
    budget: Budget,
    records: list[Record],
    *,
    steps: int,
    room: int,
    report: Callable[[Moment], None] | None,
    enlarge: Callable[[Scene], Scene],
) -> bool:
    """Go on from `steps` to the end of the budget; whether Ctrl-C came first.

    `room`: the most steps of a chunk. Appends to `records`. Whatever else `report` raises passes.
    """
    least, first = np.inf, None
    accepted = records[-1].accepted if records else 0
    pace = None
    try:
        while budget.share(steps, first) < 1:
            number = budget.next_steps(steps, room, pace)
            began = time.perf_counter()
            course.refine(budget.share(steps, first))
            losses = course.advance(number, room)
            now = time.perf_counter()
            # The first chunk compiles.
            pace = (now - began) / number if first else 0.02
            first = first or now
            steps += number
            for loss in losses[np.isfinite(losses)]:
                accepted += bool(loss < least)
                least = min(least, loss)
            found = measure(course)
            records.append(Record(steps, budget.seconds(), *found, accepted, course.active))
            if report is not None:
                report(
                    Moment(
                        records[-1],
                        budget.share(steps, first),
                        lambda: enlarge(course.scene(padded=True)),
                    )
                )
    except KeyboardInterrupt:
        return True
    return False


_ssim = jax.jit(ssim)


def measure(course: Course) -> tuple[float, float]:
    """PSNR and SSIM of the image that the last step saw; of both lights the one that is shown."""
    image, target = course.image[..., :3], course.target[..., :3]
    error = float(np.mean((image.astype(np.float64) - target) ** 2))
    decibels = -10 * np.log10(error) if error > 0 else np.inf
    alike = _ssim(jnp.asarray(image, jnp.float32), jnp.asarray(target, jnp.float32))
    return float(decibels), float(alike)
