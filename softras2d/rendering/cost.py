"""Costs of each effect of a scene: its program compared with the program without the effect.

Time is measured. Memory, operations and traffic are what the compiler reports of its program.
"""

import statistics
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple

import jax
import numpy as np

from ..planning.effects import EFFECTS, Drawing
from ..planning.plan import Plan
from ..scene import Scene
from .planner import plan as make_plan
from .render import compile_render


class Price(NamedTuple):
    """Costs of one compiled render.

    - `seconds`: the median time of a render.
    - `memory`: bytes of its arguments, image and temporaries.
    - `operations`: number of arithmetic operations.
    - `traffic`: bytes read and written by all of its kernels.
    """

    seconds: float
    memory: int
    operations: float
    traffic: float


def price_effects(
    scene: Scene, plan: Plan, *, repeats: int = 9
) -> Iterator[tuple[str | None, Price, Price]]:
    """Yield the prices of the scene with and without each of its effects.

    The first row is for None: both prices are of the whole scene. The two renders of a row are
    measured in turns, `repeats` times. Each row compiles a program, which takes seconds.
    """
    whole = _Program(scene, plan)
    price = whole.price(_median(whole.run, repeats))
    yield None, price, price
    for effect in plan.effects:
        less = _Program(*without(scene, plan, effect))
        with_it, without_it = _medians(whole.run, less.run, repeats)
        yield effect, whole.price(with_it), less.price(without_it)


def without(scene: Scene, plan: Plan, effect: str) -> tuple[Scene, Plan]:
    """The scene without one of its effects, and a plan for it: another picture, for comparison."""
    if effect not in EFFECTS:
        raise ValueError(f"`effect` must be one of {', '.join(EFFECTS)}; got {effect!r}.")
    origin = np.asarray(plan.origin)
    drawing = Drawing(scene, plan.coverage, plan.filter, plan.grid, origin)
    less = EFFECTS[effect].without(drawing)
    return less.scene, make_plan(
        less.scene,
        height=plan.height,
        width=plan.width,
        coverage=less.coverage,
        filter=less.filter,
        origin=origin,
        grid_bits=plan.grid_bits,
    )


class _Program:
    """A compiled render and what it is called with."""

    def __init__(self, scene: Scene, plan: Plan):
        self.arguments = scene, plan
        self.compiled = compile_render(scene, plan)

    def run(self) -> None:
        """Draw once, to the end."""
        jax.block_until_ready(self.compiled(*self.arguments))

    def price(self, seconds: float) -> Price:
        """The measured time, with what the compiler reports: zeros if it reports nothing."""
        program = self.compiled.compiled
        analysis = program.cost_analysis() or {}
        usage = program.memory_analysis()
        memory = 0
        if usage is not None:
            memory = (
                usage.argument_size_in_bytes + usage.output_size_in_bytes + usage.temp_size_in_bytes
            )
        return Price(
            seconds, memory, analysis.get("flops", 0.0), analysis.get("bytes accessed", 0.0)
        )


def _seconds(run: Callable[[], None]) -> float:
    began = time.perf_counter()
    run()
    return time.perf_counter() - began


def _median(run: Callable[[], None], repeats: int) -> float:
    run()
    return statistics.median(_seconds(run) for _ in range(repeats))


def _medians(
    first: Callable[[], None], second: Callable[[], None], repeats: int
) -> tuple[float, float]:
    """Median seconds of both, called in turns."""
    second()
    pairs = [(_seconds(first), _seconds(second)) for _ in range(repeats)]
    return statistics.median(a for a, _ in pairs), statistics.median(b for _, b in pairs)
