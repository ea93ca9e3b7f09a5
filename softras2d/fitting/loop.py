"""The loop: chunks of steps within a budget, a record of each, Ctrl-C with the best kept."""

import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from ..numerics.device import to_device
from ..scene import Scene
from .mesh.vertex_colors import Image
from .result import Record
from .score import compare, premultiplied

_AIM = 0.5
"""Seconds that a chunk is to take: what a user waits for Ctrl-C, and sees between two figures."""

_WATCHED = 10.0
"""How many times as long as its figures take a chunk is to be at least."""

_CHUNKS = 8
"""Into which a fit of few steps is cut at least: triangles are placed between them."""

_BETWEEN = 30.0
"""Seconds between two checkpoints at least."""

SCORING = 3.0
"""Seconds set aside for the score of an image while it is not known what it takes."""


@runtime_checkable
class Course(Protocol):
    """A fit of either family."""

    target: Image
    image: Image
    active: int

    @property
    def most(self) -> int:
        """Triangles that there may be."""
        ...

    def advance(self, steps: int, room: int) -> np.ndarray:
        """The losses of so many steps, or of fewer."""
        ...

    def refine(self, share: float) -> None:
        """What the host does between chunks, `share` of the way through the fit."""
        ...

    def scene(self, *, padded: bool = False) -> Scene:
        """The best so far, in pixels of the fit; `padded` to the size that it may reach."""
        ...


class Moment(NamedTuple):
    """What a user is shown of a fit.

    - `record`: the last one; `share`: how far the fit is, 0..1; `seconds_left`: for steps, as they
      go now, NaN while that is not known; `triangles`: how many there may be.
    - `scene()`: the best at the time of asking, in pixels of the target; triangles that wait for
      their use lie outside or have no area, so that all scenes of a fit have one size.
    """

    record: Record
    share: float
    seconds_left: float
    triangles: int
    scene: Callable[[], Scene]


class Budget(NamedTuple):
    """How long a fit may take: `steps` in all, or until `deadline`, as `time.perf_counter` has it.

    `scoring`: the seconds that come after the last step, as soon as they are known, and `guess`
    before that; `start`: when this call began; `spent`: seconds of the fit before that.
    """

    steps: int | None
    deadline: float | None
    scoring: Future[float]
    start: float
    spent: float
    guess: float = SCORING

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
        scoring = self.scoring.result() if self.scoring.done() else self.guess
        return max(0.0, self.deadline - scoring - time.perf_counter())

    def remaining(self, steps: int, pace: float) -> float:
        """Seconds to the end, after so many steps of which each takes `pace`."""
        return self.left() if self.steps is None else max(0, self.steps - steps) * pace

    def seconds(self) -> float:
        """Of the fit so far."""
        return self.spent + time.perf_counter() - self.start

    def next_steps(self, steps: int, room: int, pace: float | None, figures: float) -> int:
        """Of the chunk that comes next; `pace` is the seconds that a step takes, once known, and
        `figures` those that it takes to tell how good the picture has become."""
        if self.steps is not None:
            return chunk_of(self.steps, steps, room)
        if pace is None:
            return 1
        return int(np.clip(min(max(_AIM, _WATCHED * figures), self.left()) / pace, 1, room))


def chunk_of(steps: int, done: int, room: int) -> int:
    """How many of so many steps come next, at most `room`, for a fit that is not told seconds."""
    return min(room, -(-steps // _CHUNKS), steps - done)


def run(
    course: Course,
    budget: Budget,
    records: list[Record],
    *,
    steps: int,
    room: int,
    report: Callable[[Moment], None] | None,
    enlarge: Callable[[Scene], Scene],
    stop: Callable[[], bool],
    save: Callable[[], None] | None = None,
) -> bool:
    """Go on from `steps` to the end of the budget; whether `stop()` or Ctrl-C came first.

    `room`: the most steps of a chunk. Appends to `records`. `save` is called now and then. A
    `KeyboardInterrupt` of `report` is a Ctrl-C; whatever else it raises passes.
    """
    least, first = np.inf, None
    accepted = records[-1].accepted if records else 0
    pace, figures, saved = None, 0.0, time.perf_counter()
    while budget.share(steps, first) < 1:
        if stop():
            return True
        number = budget.next_steps(steps, room, pace, figures)
        began = time.perf_counter()
        course.refine(budget.share(steps, first))
        losses = course.advance(number, room)
        now = time.perf_counter()
        # The first chunk compiles: what a step takes is not known after it.
        pace = (now - began) / len(losses) if first else None
        steps += len(losses)
        for loss in losses[np.isfinite(losses)]:
            accepted += bool(loss < least)
            least = min(least, loss)
        found = measure(course)
        if first:
            figures = time.perf_counter() - now
        first = first or now
        records.append(Record(steps, budget.seconds(), *found, accepted, course.active))
        if report is not None:
            share, left = budget.share(steps, first), budget.remaining(steps, pace or np.nan)
            scene = lambda: enlarge(course.scene(padded=True))  # noqa: E731
            try:
                report(Moment(records[-1], share, left, course.most, scene))
            except KeyboardInterrupt:
                return True
        if save is not None and time.perf_counter() - saved > _BETWEEN:
            save()
            saved = time.perf_counter()
    return False


def measure(course: Course) -> tuple[float, float]:
    """PSNR and SSIM of the image that the last step saw; of both lights the one that is shown."""
    image, target = (
        premultiplied(to_device(one, np.float32)) for one in (course.image, course.target)
    )
    return compare(image, target)
