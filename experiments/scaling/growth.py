"""Measure time and memory of one case, for the image and for the gradient of a squared error."""

import time
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import softras2d as sr

from ..common.timing import interleave
from ..hard_speed.ours import package_scene
from .cases import Axis, Case, soups

MOST_BYTES = 16 * 2**30
MOST_CALL_S = 60.0
WHAT = ("image", "gradient")


class Program:
    """A compiled function with its arguments, and how long it took to compile.

    - `memory`: bytes of arguments, results and temporaries, as the compiler lays them out.
    - `argument_memory`: bytes of the arguments.
    """

    def __init__(self, function: Callable[..., Any], *arguments: Any):
        self.arguments = arguments
        began = time.perf_counter()
        self.compiled = jax.jit(function).lower(*arguments).compile()
        self.compile_s = time.perf_counter() - began
        memory = self.compiled.memory_analysis()
        if memory is None:
            raise ValueError("this backend does not report the memory that a program takes.")
        self.argument_memory = memory.argument_size_in_bytes
        self.memory = (
            memory.argument_size_in_bytes
            + memory.output_size_in_bytes
            + memory.temp_size_in_bytes
            - memory.alias_size_in_bytes
        )

    def __call__(self) -> Any:
        return jax.block_until_ready(self.compiled(*self.arguments))


class Drawing:
    """The scenes of a case and their plan, which took `plan_s` seconds to make."""

    def __init__(self, case: Case):
        scenes = [package_scene(soup) for soup in soups(case)]
        self.scene = scenes[0] if case.batch == 1 else jax.tree.map(_stack, *scenes)
        began = time.perf_counter()
        self.plan = sr.plan(
            self.scene,
            height=case.size_px,
            width=case.size_px,
            coverage=sr.Hard(samples=case.samples),
        )
        self.plan_s = time.perf_counter() - began
        rng = np.random.default_rng(0)
        noise = rng.random((case.size_px, case.size_px, 3), dtype=np.float32)
        self.target = jnp.asarray(noise)
        self.over_batch = case.batch > 1

    def program(self, what: str) -> Program:
        """Compile `"image"` (with overflow flag), or `"gradient"` (positions and colours)."""
        return self._image() if what == "image" else self._gradient()

    def _image(self) -> Program:
        plan = self.plan

        def draw(scene):
            return sr.render_checked(scene, plan)

        return Program(jax.vmap(draw) if self.over_batch else draw, self.scene)

    def _gradient(self) -> Program:
        plan, target = self.plan, self.target

        def loss(positions, colors, scene, target):
            drawn = replace(scene, positions=positions, colors=colors)
            return jnp.mean((sr.render_checked(drawn, plan)[0] - target) ** 2)

        def gradient(scene, target):
            return jax.grad(loss, (0, 1))(scene.positions, scene.colors, scene, target)

        if self.over_batch:
            gradient = jax.vmap(gradient, (0, None))
        return Program(gradient, self.scene, target)


def _stack(*leaves: Any) -> Any:
    return jnp.stack(leaves)


def measure_axis(
    axis: Axis, known: dict[Case, list[dict[str, Any]]], budget_s: float
) -> list[dict[str, Any]]:
    """Two rows per size, for image and gradient; `known` caches cases that several axes share."""
    rows: list[dict[str, Any]] = []
    for size, case in axis.cases():
        if case not in known:
            known[case] = _measure(case, _foreseen(rows, size), budget_s)
        about = {"axis": axis.name, "size": size}
        rows += [about | row for row in known[case]]
    return rows


def _foreseen(rows: list[dict[str, Any]], size: float) -> dict[str, float]:
    """Estimated seconds of a call at `size`, in proportion to the time at the last size.

    Infinite if the last size was left out.
    """
    last = {row["what"]: row for row in rows}
    return {
        what: row["least_ms"] / 1e3 * size / row["size"] if row["least_ms"] else np.inf
        for what, row in last.items()
    }


def _measure(case: Case, foreseen_s: dict[str, float], budget_s: float) -> list[dict[str, Any]]:
    drawing = Drawing(case)
    rows: dict[str, dict[str, Any]] = {}
    programs: dict[str, Program] = {}
    for what in WHAT:
        row = {"what": what, **asdict(case), "plan_ms": 1e3 * drawing.plan_s}
        row |= dict.fromkeys(("compile_s", "memory_mib", "median_ms", "least_ms", "cpu_ms"), "")
        rows[what] = row | {"calls": 0, "left_out": ""}
        if foreseen_s.get(what, 0.0) > MOST_CALL_S:
            slow = foreseen_s[what] < np.inf
            why = "more than a minute a call foreseen" if slow else "as the size before it"
            rows[what]["left_out"] = why
            continue
        program = drawing.program(what)
        rows[what] |= {"compile_s": program.compile_s, "memory_mib": program.memory / 2**20}
        if program.memory > MOST_BYTES:
            rows[what]["left_out"] = "more than 16 GiB"
            continue
        programs[what] = program
    if "image" in programs:
        _refuse_missing_triangles(case, programs["image"])
    rounds = 7 if max(foreseen_s.values(), default=0.0) < 2 else 2
    for what, times in interleave(programs, rounds=rounds, budget_s=budget_s).items():
        rows[what] |= {
            "median_ms": times.median,
            "least_ms": times.least,
            "cpu_ms": times.cpu,
            "calls": times.calls,
        }
    return list(rows.values())


def _refuse_missing_triangles(case: Case, draw: Program) -> None:
    _, overflow = draw()
    if np.any(overflow):
        raise ValueError(f"the plan of {case} is too small for the scene it was made for.")
