"""What each effect of a scene costs: the program with it, against the program without it.

Time is measured; memory, operations and traffic are what the compiler says of its program.
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
    """What a program takes.

    - `seconds`: of a render, the median; `memory`: bytes of its arguments, image and temporaries.
    - `operations`, `traffic`: arithmetic, and bytes read and written by all of its kernels.
    """

    seconds: float
    memory: int
    operations: float
    traffic: float


def price_effects(
    scene: Scene, plan: Plan, *, repeats: int = 9
) -> Iterator[tuple[str | None, Price, Price]]:
    """For None, which stands for the whole scene, and then each effect: prices with and without it.

    The two of a row are measured in turns, `repeats` times. Nothing is left out for None: both are
    of the whole scene. Each row compiles a program, which takes seconds.
    """
    whole = _Program(scene, plan)
    price = whole.price(_median(whole.run, repeats))
    yield None, price, price
    for effect in plan.effects:
        less = _Program(*without(scene, plan, effect))
        with_it, without_it = _medians(whole.run, less.run, repeats)
        yield effect, whole.price(with_it), less.price(without_it)


def without(scene: Scene, plan: Plan, effect: str) -> tuple[Scene, Plan]:
    """The scene and a plan for it, less one of `EFFECTS`: another picture, for comparison."""
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
        """With what the compiler says; backends that do not tell give zeros."""
        program = self.compiled.compiled
        analysis = program.cost_analysis() or {}
        held = program.memory_analysis()
        memory = 0
        if held is not None:
            memory = (
                held.argument_size_in_bytes + held.output_size_in_bytes + held.temp_size_in_bytes
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
    """Of both, called in turns."""
    second()
    pairs = [(_seconds(first), _seconds(second)) for _ in range(repeats)]
    return statistics.median(a for a, _ in pairs), statistics.median(b for _, b in pairs)
