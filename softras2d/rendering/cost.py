"""What each effect of a scene costs: the program with it, against the program without it.

Time is measured; memory, operations and traffic are what the compiler says of its program.
"""

import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import NamedTuple

import jax
import numpy as np

from ..geometry.fixed_point import snapped_corners, within_guard
from ..options import Area, Filter, Hard, Soft
from ..planning.effects import EFFECTS
from ..planning.plan import Plan, plan
from ..planning.simplify import take_triangles
from ..scene import Scene
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
    coverage, filter = plan.coverage, plan.filter
    textures = scene.textures
    match effect:
        case "interpolated colour":
            scene = replace(scene, colors=scene.colors.mean(1, keepdims=True))
        case "translucency":
            if textures is not None:
                textures = replace(textures, texels=textures.texels[:, :3])
            scene = replace(scene, colors=scene.colors[..., :3], textures=textures)
        case "translucent background":
            scene = replace(scene, background=scene.background[:3])
        case "texture":
            scene = replace(scene, uv=None, texture_index=None, textures=None)
        case "mip levels":
            filter = replace(filter, level="zero")
        case "bilinear filter":
            filter = replace(filter, pixel="nearest")
        case "anisotropic filter":
            filter = replace(filter, anisotropy=1)
        case "perspective":
            scene = replace(scene, inverse_w=None)
        case "depth test":
            scene = replace(scene, depth=None)
        case "pixel shading":
            coverage = replace(coverage, shading="sample")
        case "soft coverage" | "exact area":
            coverage = Hard(samples=1)
        case "guard band":
            positions, triangles = np.asarray(scene.positions), np.asarray(scene.triangles)
            corners = snapped_corners(positions, triangles, np.asarray(plan.origin), plan.grid)
            scene = take_triangles(scene, within_guard(corners, plan.grid))
    return scene, _plan_again(scene, plan, coverage, filter)


def _plan_again(scene: Scene, old: Plan, coverage: Hard | Soft | Area, filter: Filter) -> Plan:
    return plan(
        scene,
        height=old.height,
        grid_bits=old.grid_bits,
        width=old.width,
        coverage=coverage,
        filter=filter,
        origin=np.asarray(old.origin),
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
