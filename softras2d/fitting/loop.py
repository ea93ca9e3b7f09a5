"""The loop of a fit: chunks of steps within a budget, with a record and a report after each.

The same loop serves `fit` and `fit_batch`. It advances a list of fits together, of which `fit` has
one.
"""

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..color import premultiply
from ..numerics.device import Devices, to_device
from ..scene import Scene
from .budget import Budget
from .chunk import advance_fits
from .family import AbstractFit
from .result import Record
from .score import psnr_and_ssim

_CHECKPOINT_SECONDS = 30.0
"""Least number of seconds between two checkpoints."""


class ProgressReport(NamedTuple):
    """The state of a running fit, which the functions `report` and `callback` of `fit` receive.

    - `record`: the record of the last chunk.
    - `share`: share of the fit that is done, 0..1.
    - `seconds_left`: estimated time to the last step; NaN until it is known.
    - `triangles`: the largest number of triangles that the fit may have.
    - `scene()`: returns the scene with the least loss so far, in pixels of the target. All scenes
      of a fit have the same shapes: triangles not in use lie outside the canvas or have no area.
    - `saved_psnr`: PSNR, in dB, that the result would have if the best scene were saved now. It is
      computed from time to time in another thread; this is the last value, NaN before the first.
    """

    record: Record
    share: float
    seconds_left: float
    triangles: int
    scene: Callable[[], Scene]
    saved_psnr: float = np.nan


class AcceptedSteps:
    """Counts accepted steps. Their loss is below all losses before them in this call of `fit`.

    `count`: number of accepted steps before this call, in the fit that is resumed; else 0.
    """

    def __init__(self, count: int):
        self._count = count
        self._least_loss = np.inf

    def add(self, losses: Float[np.ndarray, " steps"]) -> int:
        """Count the accepted steps of a chunk, from its losses; return the count so far."""
        for loss in losses[np.isfinite(losses)]:
            self._count += bool(loss < self._least_loss)
            self._least_loss = min(self._least_loss, loss)
        return self._count


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
    devices: Devices | None = None,
) -> bool:
    """Advance fits together to the end of the budget; return whether Ctrl-C ended them before.

    - `histories`: one for each fit, to which a record is appended after each chunk.
    - `steps`: number of steps taken before this call, by the fit that is resumed; else 0.
    - `max_steps`: the largest number of steps of one chunk, not of the fit.
    - `stop()`: returns whether Ctrl-C was pressed; called before each chunk.
    - `report(share, seconds_left)`: called after each chunk with the share of the fit that is done,
      0..1, and the seconds to the last step, NaN if not known. A `KeyboardInterrupt` from it counts
      as Ctrl-C; any other exception is passed on.
    - `save()`: writes a checkpoint; called every half minute.
    - `devices`: those among which the fits are shared; JAX's first device unless given.
    """
    counters = [AcceptedSteps(records[-1].accepted if records else 0) for records in histories]
    compiled_at: float | None = None
    step_seconds: float | None = None
    measure_seconds = 0.0
    saved_at = time.perf_counter()
    while budget.share(steps, compiled_at) < 1:
        if stop():
            return True
        chunk_steps = budget.next_steps(steps, max_steps, step_seconds, measure_seconds)
        began = time.perf_counter()
        for fit in fits:
            fit.refine(budget.share(steps, compiled_at))
        losses = advance_fits(fits, chunk_steps, max_steps, devices)
        now = time.perf_counter()
        # The first chunk compiles, so it does not tell how long a step takes.
        step_seconds = (now - began) / len(losses[0]) if compiled_at else None
        steps += len(losses[0])
        accepted = [
            counter.add(fit_losses) for counter, fit_losses in zip(counters, losses, strict=True)
        ]
        for fit, history, count in zip(fits, histories, accepted, strict=True):
            psnr, ssim = measure(fit)
            history.append(Record(steps, budget.seconds(), psnr, ssim, count, fit.active))
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
    """PSNR, in dB, and SSIM of the image of the last step against the target of the fit.

    They are computed from sRGB values, premultiplied if there is alpha, over all pixels and
    channels at the size of the fit; weights do not count.
    """
    image, target = (
        premultiply(to_device(array, np.float32)) for array in (fit.image, fit.request.target.image)
    )
    return psnr_and_ssim(image, target)
