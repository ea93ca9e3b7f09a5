"""Many images of one size fitted together: one program takes a step of each."""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..numerics.compiled_programs import drop_programs
from ..rendering.planner import plan
from ..scene import Scene
from . import choices
from .chunk import solve_between
from .interrupt import Interrupt, held_interrupt
from .layers.family import LayersFit
from .layers.unknowns import LayersResidual, layers_scene
from .loop import SCORING, Budget, measure
from .mesh.triangulation import Mesh
from .prepare import STEPS, check_images, check_resume, resumed
from .result import FitResult, Record
from .solve import RENEWALS, advance_each, move
from .task import Task


def fit_batch(
    targets: Sequence[Any],
    *,
    triangles: int = 500,
    solver: str = "adam",
    seed: int = 0,
    steps: int | None = None,
    seconds: int | float | None = None,
    size: int | None = None,
    shading: str = "flat",
    translucent: bool = False,
    softness: Any = 0.8,
    colors: str = "together",
    loss: str = "squared",
    light: str = "display",
    weights: Any = None,
    start: Any = "error",
    report: Callable[[list[Record]], None] | None = None,
    resume: Sequence[FitResult] | None = None,
) -> list[FitResult]:
    """`fit` by layers of several targets of one shape, their steps batched by `jax.vmap`.

    Arguments are those of `fit`; image k has the seed `seed` + k, and its result is that of a fit
    alone up to rounding and to where chunks end. `weights` (`[height, width]` or `[images, height,
    width]`) and `start` serve for all or are one for each target; `resume` are the results of an
    earlier batch, whose settings and weights count. `report` is called after each chunk with the
    last record of each image; the seconds there are those of all together. Ctrl-C acts as in `fit`.
    Raises `ValueError`, one line, as `fit` does, and for targets of different shapes or none.
    """
    began = time.perf_counter()
    drop_programs()
    images = check_images(targets)
    shapes = {image.shape for image in images}
    if len(shapes) != 1:
        raise ValueError(f"`targets` must be images of one shape; got {sorted(shapes)}.")
    given: dict[str, Any] = {
        "triangles": triangles, "family": "layers", "solver": solver, "seed": seed, "size": size,
        "shading": shading, "translucent": translucent, "softness": softness,
        "colors": colors, "loss": loss, "light": light,
    }  # fmt: skip
    count = len(images)
    earlier = _each("resume", resume, count)
    if resume is not None:
        for one in earlier:
            check_resume(one, images[0])
    own = _settings(given, _each("start", start, count), earlier, steps, seconds)
    maps = _maps(weights, count)
    if resume is not None:
        maps = [one.state.get("weights.given") for one in earlier]
    if len({one is None for one in maps}) > 1:
        raise ValueError("`weights` must be given for every target or for none.")
    if steps is None and seconds is None:
        steps = STEPS
    deadline = None if seconds is None else began + seconds
    with jax.enable_x64(False), held_interrupt() as interrupt:
        tasks = [
            Task(image, choices.prepare_weights(one, image), each, before)
            for image, one, each, before in zip(images, maps, own, earlier, strict=True)
        ]
        interrupted = _run(tasks, began, steps, deadline, report, interrupt)
        results = []
        for task in tasks:
            # Prepared in `_run`.
            task.scorer.adopt(tasks[0].scorer)
            if task.polishes and not (interrupted or interrupt.asked):
                task.course.polish()
            results.append(task.result(interrupted))
    return [replace(result, interrupted=True) if interrupt.asked else result for result in results]


def _settings(
    given: dict[str, Any],
    starts: list[Any],
    earlier: list[FitResult | None],
    steps: Any,
    seconds: Any,
) -> list[dict[str, Any]]:
    """Those of each fit, settled; `ValueError` where they make no sense, or not together."""
    every = choices.settle(given | {"start": None})
    choices.check(every, steps, seconds)
    own = []
    for k, (start, before) in enumerate(zip(starts, earlier, strict=True)):
        each = every | {"seed": every["seed"] + k, "start": start}
        own.append(each if before is None else choices.settle(resumed(each, before)))
    alike = {"seed": 0, "start": None}
    if any(each | alike != own[0] | alike for each in own):
        raise ValueError("`resume` must be fits with the same settings.")
    if own[0]["family"] != "layers":
        raise ValueError(f"`resume` must be fits of layers; got those of a {own[0]['family']}.")
    if len({one.history[-1:] and one.history[-1].steps for one in earlier if one}) > 1:
        raise ValueError("`resume` must be fits of as many steps each.")
    return own


def _each(name: str, value: Any, count: int) -> list[Any]:
    """One for each target: the entries of a sequence, or the one that serves for all."""
    if value is None or isinstance(value, str | Scene | Mesh):
        return [value] * count
    several = isinstance(value, Sequence | np.ndarray | jax.Array)
    if not several or len(value) != count:
        told = f"{len(value)}" if several else f"{value!r:.60}"
        raise ValueError(f"`{name}` must be one for each of {count} targets; got {told}.")
    return list(value)


def _maps(weights: Any, count: int) -> list[Any]:
    """Weights of each target: one map for all, or as many as targets."""
    several = isinstance(weights, list | tuple) and len(weights) > 0 and np.ndim(weights[0]) != 1
    if several or (isinstance(weights, np.ndarray | jax.Array) and weights.ndim == 3):
        return _each("weights", weights, count)
    return [weights] * count


def _run(
    tasks: list[Task],
    began: float,
    steps: int | None,
    deadline: float | None,
    report: Callable[[list[Record]], None] | None,
    interrupt: Interrupt,
) -> bool:
    """All of them to the end of the budget, a record of each chunk; whether Ctrl-C came first."""
    courses = [task.course for task in tasks if isinstance(task.course, LayersFit)]
    room = tasks[0].room if steps is None else min(tasks[0].room, max(1, steps))
    least = np.full(len(tasks), np.inf)
    accepted = np.array([task.records[-1].accepted if task.records else 0 for task in tasks])
    done, first, pace, figures = tasks[0].done, None, None, 0.0
    rehearse = tasks[0].rehearsal(deadline is not None)
    with ThreadPoolExecutor(1) as pool:
        ending = pool.submit(lambda: len(tasks) * rehearse())
        guess = SCORING * len(tasks)
        budget = Budget(steps, deadline, ending, began, tasks[0].spent, guess)
        while budget.share(done, first) < 1:
            if interrupt.asked:
                return True
            start = time.perf_counter()
            for course in courses:
                course.refine(budget.share(done, first))
            losses = _advance(courses, budget.next_steps(done, room, pace, figures), room)
            # The first chunk compiles: what a step takes is not known after it.
            now = time.perf_counter()
            pace = (now - start) / len(losses[0]) if first else None
            done += len(losses[0])
            for k, task in enumerate(tasks):
                for one in losses[k][np.isfinite(losses[k])]:
                    accepted[k] += one < least[k]
                    least[k] = min(least[k], one)
                found = measure(task.course)
                own = Record(done, budget.seconds(), *found, int(accepted[k]), task.course.active)
                task.records.append(own)
            if first:
                figures = time.perf_counter() - now
            first = first or now
            if report is not None:
                try:
                    report([task.records[-1] for task in tasks])
                except KeyboardInterrupt:
                    return True
    return False


def _advance(courses: list[LayersFit], steps: int, room: int) -> list[np.ndarray]:
    """Losses of so many steps of each; of half as many under another plan if one outgrows theirs,
    as in `solve.advance_within_plan`."""
    first = courses[0]
    old, most = first.residual.plan, max(first.choice.softness)
    for course in courses:
        solve_between(course)
    seen = [first.likely()]
    seen += [layers_scene(course.progress.y, course.data.background) for course in courses]
    for _ in range(RENEWALS):
        found = advance_each(
            first.solver,
            first.residual,
            [course.progress for course in courses],
            [course.data for course in courses],
            steps=steps,
            room=room,
        )
        if not any(bool(jnp.any(outgrown)) for _, _, (_, outgrown) in found):
            for course, (after, _, (image, _)) in zip(courses, found, strict=True):
                course.progress, course.image = after, np.asarray(image)
            return [np.asarray(losses) for _, losses, _ in found]
        for course, (after, _, _) in zip(courses, found, strict=True):
            seen.append(layers_scene(after.y, course.data.background))
        held = plan(seen, height=old.height, width=old.width, coverage=old.coverage, max_width=most)
        steps = max(1, steps // 2)
        for course in courses:
            course.residual = LayersResidual(held, first.loss)
            course.progress = move(
                course.solver, course.residual, course.progress, course.progress.y, course.data
            )
    raise RuntimeError("a plan stays too small for the scenes that it was made for.")
