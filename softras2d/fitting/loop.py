"""The loop of a fit: chunks of steps until the limit, with a record and a report after each.

A *chunk* is a number of solver steps that run as one compiled program. The same loop serves `fit`
and `fit_batch`. It advances a list of fits together, which has one fit in the case of `fit`.
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

    - `record`: the record of the last chunk of steps.
    - `share`: share of the fit that is done, 0..1.
    - `seconds_left`: estimated seconds until the last step; NaN until the estimate is known.
    - `triangles`: the largest number of triangles that the fit may have; for a mesh, the present
      number.
    - `scene()`: returns the scene with the least loss so far, in pixels of the target. All scenes
      of a fit have the same shapes: triangles that are not in use lie outside the canvas or have no
      area.
    - `saved_psnr`: PSNR, in dB, of the scene with the least loss, scored as the result will be. It
      is computed from time to time in another thread. The field has the last value that was
      computed, and NaN before the first.
    """

    record: Record
    share: float
    seconds_left: float
    triangles: int
    scene: Callable[[], Scene]
    saved_psnr: float = np.nan


class AcceptedSteps:
    """Counts accepted steps: those whose loss is below all earlier losses in this call of `fit`.

    The first step of the call is accepted, unless its loss is not finite. `count`: number of
    accepted steps of the fit that is resumed; 0 for a new fit.
    """

    def __init__(self, count: int):
        self._count = count
        self._least_loss = np.inf

    def add(self, losses: Float[np.ndarray, " steps"]) -> int:
        """Count the accepted steps of a chunk, from the loss of each of its steps.

        Returns the number of accepted steps so far.
        """
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
    """Advance fits together until the budget is used; return whether Ctrl-C ended them early.

    - `fits`: fits with the same shapes and solver, and with the same settings but for `seed` and
      `start`. They are changed in place.
    - `histories`: one list for each fit, to which a record is appended after each chunk.
    - `budget`: the limit of steps or seconds.
    - `steps`: number of steps of the fit that is resumed; 0 for a new fit.
    - `max_steps`: the largest number of steps of one chunk, not of the fit.
    - `stop()`: returns whether Ctrl-C was pressed; called before each chunk.
    - `report(share, seconds_left)`: called after each chunk with the share of the fit that is done,
      0..1, and the seconds until the last step, NaN if not known. A `KeyboardInterrupt` from this
      function counts as Ctrl-C; any other exception is passed on.
    - `save()`: writes a checkpoint; called about every half minute, after a chunk.
    - `devices`: devices that share the fits, as in `solve.advance_each`; JAX's first device by
      default.
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
    """Compute the PSNR, in dB, and the SSIM of the image of a fit's last step against its target.

    Both compare sRGB values over all pixels and channels at the size of the fit. Images with alpha
    are premultiplied. The weights of the pixels are ignored.
    """
    image, target = (
        premultiply(to_device(array, np.float32)) for array in (fit.image, fit.request.target.image)
    )
    return psnr_and_ssim(image, target)
