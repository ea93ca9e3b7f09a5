"""Many images of one size fitted together: one program takes a step of each."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..plan import plan
from . import choices, snapshot
from .interrupt import Interrupt, held_interrupt
from .layers import LayersResidual, layers_scene
from .layers_fit import LayersFit
from .loop import chunk_of, measure
from .prepare import STEPS, Frame, check_images, kept, make_course, room_of
from .result import FitResult, Record
from .score import Scorer
from .solve import RENEWALS, advance_each, move


def fit_batch(
    targets: Sequence[Any],
    *,
    triangles: int = 500,
    solver: str = "adam",
    seed: int = 0,
    steps: int = STEPS,
    size: int | None = None,
    shading: str = "flat",
    translucent: bool = False,
    softness: Any = 0.8,
    loss: str = "squared",
    light: str = "display",
    report: Callable[[list[Record]], None] | None = None,
) -> list[FitResult]:
    """`fit` by layers of several targets of one shape, their steps batched by `jax.vmap`.

    Arguments are those of `fit`; image k has the seed `seed` + k, and its result is that of a fit
    alone up to rounding. `report` is called after each chunk with the last record of each image;
    the seconds there are those of all together. Ctrl-C acts as in `fit`. Raises `ValueError`, one
    line, as `fit` does, and for targets of different shapes or none.
    """
    began = time.perf_counter()
    images = check_images(targets)
    shapes = {image.shape for image in images}
    if len(shapes) != 1:
        raise ValueError(f"`targets` must be images of one shape; got {sorted(shapes)}.")
    settings: dict[str, Any] = {
        "triangles": triangles, "family": "layers", "solver": solver, "seed": seed, "size": size,
        "shading": shading, "translucent": translucent, "softness": softness,
        "colors": "together", "loss": loss, "light": light, "start": "error",
    }  # fmt: skip
    settings = choices.settle(settings)
    choices.check(settings, steps, None)
    height, width = images[0].shape[:2]
    frame = Frame.of(height, width, settings)
    own = [settings | {"seed": seed + k} for k in range(len(images))]
    courses = [
        make_course(image, None, each, frame, None) for image, each in zip(images, own, strict=True)
    ]
    layers = [course for course in courses if isinstance(course, LayersFit)]
    room = room_of(layers[0].solver, frame)
    with jax.enable_x64(False), held_interrupt() as interrupt:
        histories = _run(layers, steps, room, began, report, interrupt)
        results = []
        for course, image, each, records in zip(layers, images, own, histories, strict=True):
            scene = frame.enlarge(course.scene())
            state = snapshot.take(course, records[-1].steps if records else 0)
            score = Scorer(image).score(scene)
            results.append(FitResult(scene, *score, tuple(records), kept(each), False, state))
    return [replace(result, interrupted=interrupt.asked) for result in results]


def _run(
    courses: list[LayersFit],
    steps: int,
    room: int,
    began: float,
    report: Callable[[list[Record]], None] | None,
    interrupt: Interrupt,
) -> list[list[Record]]:
    """All of them to the end or to Ctrl-C, and a record of each chunk."""
    histories: list[list[Record]] = [[] for _ in courses]
    least = np.full(len(courses), np.inf)
    accepted = np.zeros(len(courses), int)
    done = 0
    while done < steps and not interrupt.asked:
        for course in courses:
            course.refine(done / steps)
        losses = _advance(courses, chunk_of(steps, done, room))
        done += len(losses[0])
        seconds = time.perf_counter() - began
        for k, course in enumerate(courses):
            for one in losses[k][np.isfinite(losses[k])]:
                accepted[k] += one < least[k]
                least[k] = min(least[k], one)
            found = measure(course)
            histories[k].append(Record(done, seconds, *found, int(accepted[k]), course.active))
        if report is not None:
            report([records[-1] for records in histories])
    return histories


def _advance(courses: list[LayersFit], steps: int) -> list[np.ndarray]:
    """Losses of so many steps of each; of half as many under another plan if one outgrows theirs,
    as in `solve.advance_within_plan`."""
    first = courses[0]
    old, most = first.residual.plan, max(first.choice.softness)
    seen = [first.likely()]
    seen += [layers_scene(course.progress.y, course.data.background) for course in courses]
    for _ in range(RENEWALS):
        found = advance_each(
            first.solver,
            first.residual,
            [course.progress for course in courses],
            [course.data for course in courses],
            steps=steps,
        )
        if not any(bool(jnp.any(outgrown)) for _, _, (_, outgrown) in found):
            for course, (after, _, (image, _)) in zip(courses, found, strict=True):
                course.progress, course.image = after, np.asarray(image)
            return [np.asarray(losses) for _, losses, _ in found]
        for course, (after, _, _) in zip(courses, found, strict=True):
            seen.append(layers_scene(after.y, course.data.background))
        room = plan(seen, height=old.height, width=old.width, coverage=old.coverage, max_width=most)
        steps = max(1, steps // 2)
        for course in courses:
            course.residual = LayersResidual(room, first.loss)
            course.progress = move(
                course.solver, course.residual, course.progress, course.progress.y, course.data
            )
    raise RuntimeError("a plan stays too small for the scenes that it was made for.")
