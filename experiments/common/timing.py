"""Time several programs in turn, so that drift of the machine affects all of them equally."""

import gc
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Times:
    """Milliseconds of one call: median and least wall-clock time, and processor time (`cpu`).

    `cpu` is the median of the processor time of all threads of this process. If `cpu` is well
    below `median`, the machine was busy with something else. If `cpu` is well above `median`,
    several cores worked.
    """

    median: float
    least: float
    cpu: float
    calls: int


def interleave(
    contestants: Mapping[str, Callable[[], object]],
    *,
    rounds: int = 7,
    budget_s: float = 20.0,
) -> dict[str, Times]:
    """Time every contestant once per round, in an order that rotates; return the times of each.

    A contestant must return when its work is done (block on asynchronous results). Each contestant
    is called once before all rounds, to compile. An untimed call precedes each timed call, since
    the previous contestant has filled the caches. Contestants that take more than their share of
    `budget_s` get fewer rounds and no untimed call: at least five rounds if a call takes under half
    a second, else at least three.
    """
    names = list(contestants)
    warm_s = {name: _warm_up(contestants[name]) for name in names}
    share_s = budget_s / max(1, len(names))
    wanted = {name: _rounds(warm_s[name], share_s, rounds) for name in names}
    samples: dict[str, list[tuple[float, float]]] = {name: [] for name in names}
    # With the objects of many compiled programs, one garbage collection takes half a second, so the
    # existing objects are excluded from collections.
    gc.collect()
    gc.freeze()
    try:
        for turn in range(max(wanted.values(), default=0)):
            first = turn % len(names)
            for name in names[first:] + names[:first]:
                if turn < wanted[name]:
                    again = warm_s[name] * 6 < share_s
                    samples[name].append(_timed(contestants[name], warm=again))
    finally:
        gc.unfreeze()
    return {name: _summary(samples[name]) for name in names}


def _rounds(call_s: float, share_s: float, most: int) -> int:
    fewest = 5 if call_s < 0.5 else 3
    return min(most, max(fewest, int(share_s / (2 * call_s + 1e-9))))


def _warm_up(call: Callable[[], object]) -> float:
    """Seconds of the second call; the first call compiles and allocates."""
    call()
    return _timed(call, warm=False)[0]


def _timed(call: Callable[[], object], *, warm: bool) -> tuple[float, float]:
    if warm:
        call()
    gc.collect()
    gc.disable()
    try:
        cpu, wall = time.process_time(), time.perf_counter()
        call()
        return time.perf_counter() - wall, time.process_time() - cpu
    finally:
        gc.enable()


def _summary(samples: list[tuple[float, float]]) -> Times:
    wall, cpu = 1e3 * np.array(samples).T
    return Times(float(np.median(wall)), float(wall.min()), float(np.median(cpu)), len(samples))
