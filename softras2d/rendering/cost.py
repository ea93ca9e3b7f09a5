"""Cost of each effect of a scene, from renders of the scene with the effect and without it.

Time is measured. Memory, operations and traffic are estimates that the compiler reports.
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
    - `memory`: size, in bytes, of the arguments, the image and temporary arrays of a render.
    - `operations`: number of floating-point operations of a render.
    - `traffic`: number of bytes that a render reads and writes.

    All but `seconds` are estimates of the compiler, or 0 where it gives none.
    """

    seconds: float
    memory: int
    operations: float
    traffic: float


def price_effects(
    scene: Scene, plan: Plan, *, repeats: int = 9
) -> Iterator[tuple[str | None, Price, Price]]:
    """Yield each effect of the scene, with the price of a render with and without the effect.

    Yields rows of the effect's name, the price of the complete scene, and the price of the scene
    without this one effect. The effects are those of `plan`, in its order. In the first row the
    name is None, and both prices are of the complete scene. The two renders of a row are measured
    in turns, `repeats` times. Each row compiles a program, which takes seconds.
    """
    complete = _Program(scene, plan)
    price = complete.price(_median(complete.run, repeats))
    yield None, price, price
    for effect in plan.effects:
        reduced = _Program(*without_effect(scene, plan, effect))
        complete_seconds, reduced_seconds = _medians(complete.run, reduced.run, repeats)
        yield effect, complete.price(complete_seconds), reduced.price(reduced_seconds)


def without_effect(scene: Scene, plan: Plan, effect: str) -> tuple[Scene, Plan]:
    """Remove one effect from a scene; return the simpler scene and a plan for it.

    `effect` is a name in `effects.EFFECTS`. The new plan has the canvas, origin and grid of `plan`.
    It has the coverage and the filter of `plan` too, except for what makes up the effect; its
    capacities are chosen for the simpler scene, with the default headroom. The simpler scene has a
    different image: it is for comparing costs only. Raises `ValueError` if there is no effect of
    this name.
    """
    if effect not in EFFECTS:
        raise ValueError(f"`effect` must be one of {', '.join(EFFECTS)}; got {effect!r}.")
    origin = np.asarray(plan.origin)
    drawing = Drawing(scene, plan.coverage, plan.filter, plan.grid, origin)
    reduced = EFFECTS[effect].without(drawing)
    return reduced.scene, make_plan(
        reduced.scene,
        height=plan.height,
        width=plan.width,
        coverage=reduced.coverage,
        filter=reduced.filter,
        origin=origin,
        grid_bits=plan.grid_bits,
    )


class _Program:
    """The compiled program of a render, and the scene and the plan that it draws."""

    def __init__(self, scene: Scene, plan: Plan):
        self.arguments = scene, plan
        self.compiled = compile_render(scene, plan)

    def run(self) -> None:
        """Draw once, and wait for the image."""
        jax.block_until_ready(self.compiled(*self.arguments))

    def price(self, seconds: float) -> Price:
        """The price of a render that took `seconds`, with the compiler's estimates.

        An estimate that the compiler does not give is 0.
        """
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
    """Time of one call, in seconds."""
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def _median(run: Callable[[], None], repeats: int) -> float:
    """Median time of `repeats` calls, in seconds, after one call that is not measured."""
    run()
    return statistics.median(_seconds(run) for _ in range(repeats))


def _medians(
    first: Callable[[], None], second: Callable[[], None], repeats: int
) -> tuple[float, float]:
    """Median times, in seconds, of two functions that are called in turns, `repeats` times.

    The second function is called once before, unmeasured; the first must have been called already.
    """
    second()
    pairs = [(_seconds(first), _seconds(second)) for _ in range(repeats)]
    return statistics.median(a for a, _ in pairs), statistics.median(b for _, b in pairs)
