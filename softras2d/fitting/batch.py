"""The public function `fit_batch`, which fits several images of one size by one program."""

import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from ..numerics.compiled_programs import drop_programs
from ..numerics.device import Devices, check_devices
from ..scene import Scene
from . import choices, steering
from .budget import END_SECONDS, Budget, Limits
from .interrupt import Interrupt, deferred_interrupt
from .loop import run
from .loss import LossFunction
from .mesh.triangulation import Mesh
from .prepare import check_images, check_resume, is_transparent, settings_to_resume
from .result import FitResult, Record
from .target import Image, Target
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
    loss: str | LossFunction = "squared",
    light: str = "display",
    weights: Any = None,
    start: Any = "error",
    palette: Any = None,
    freeze: Any = None,
    background: Any = "mean",
    report: Callable[[list[Record]], None] | None = None,
    resume: Sequence[FitResult] | None = None,
    devices: Devices | None = None,
) -> list[FitResult]:
    """Fit layers to several targets of one shape, with their steps batched by `jax.vmap`.

    Returns one result for each target, in their order. The arguments are as in `fit`, with these
    differences:

    - `targets`: images of one shape.
    - `seed`: image k has the seed `seed` + k. `fit` with this seed gives the same result, but for
      rounding and for the steps at which chunks end.
    - `weights`: `[height, width]` for all targets, or `[images, height, width]`.
    - `start`: one for all targets, or a sequence with one for each.
    - `resume`: the results of an earlier batch, in the order of `targets`; their settings and
      weights are used.
    - `palette`: if it is a number of colours, the fit of each image chooses its own.
    - `freeze`: names only; masks are refused.
    - `devices`: devices of JAX that share the images as evenly as blocks of one size allow, by the
      same program and without communication. JAX's first device unless given.
    - `report`: called after each chunk with the last record of each image. The seconds in a record
      are those of all images together.
    - There is no `family`, `callback` or `checkpoint`.

    Ctrl-C acts as in `fit`. Raises `ValueError`, one line, as `fit` does, and for no targets or
    targets of different shapes.
    """
    began = time.perf_counter()
    groups, masks = steering.normalize_freeze(freeze)
    _refuse_masks(masks)
    given: dict[str, Any] = {
        "triangles": triangles, "family": "layers", "solver": solver, "seed": seed, "size": size,
        "shading": shading, "translucent": translucent, "softness": softness,
        "colors": colors, "loss": loss, "light": light, "palette": palette, "freeze": groups,
        "background": background,
    }  # fmt: skip
    if devices is not None:
        devices = check_devices(devices)
    drop_programs()
    images = _check_targets(
        targets,
        is_transparent(background, resume[0] if isinstance(resume, Sequence) and resume else None),
    )
    count = len(images)
    earlier = _check_earlier(resume, count, images[0])
    settings = _settings(given, _for_each("start", start, count), earlier, steps, seconds)
    weight_maps = _weight_maps(weights, earlier)
    limits = Limits.of(began, steps, seconds)
    with jax.enable_x64(False), deferred_interrupt() as interrupt:
        tasks = [
            Task(Target(image, choices.prepare_weights(weight_map, image)), fit_settings, result)
            for image, weight_map, fit_settings, result in zip(
                images, weight_maps, settings, earlier, strict=True
            )
        ]
        interrupted = _run(tasks, limits, report, lambda: interrupt.requested, devices)
        interrupt.raise_if_repeated()
        results = _finish(tasks, interrupted, interrupt)
    if interrupt.requested:
        return [replace(result, interrupted=True) for result in results]
    return results


def _check_earlier(
    resume: Sequence[FitResult] | None, count: int, image: Image
) -> list[FitResult | None]:
    """Return the result that each of `count` fits resumes; a list of None if `resume` is None.

    Raises `ValueError` unless `resume` has `count` results of fits without masks, each of which can
    be resumed with a target of the size of `image`.
    """
    earlier = _for_each("resume", resume, count)
    if resume is not None:
        for result in earlier:
            check_resume(result, image)
            _refuse_masks(result.settings["freeze"])
    return earlier


def _finish(tasks: list[Task], interrupted: bool, interrupt: Interrupt) -> list[FitResult]:
    """Make the result of each fit, after solving for its colours if the settings ask for that.

    The results are scored at the size of the targets, by one program if its capacities suffice.

    - `interrupted`: whether Ctrl-C ended the steps. Then colours are not solved for.
    - `interrupt`: tells whether Ctrl-C is pressed later. From then on, colours are not solved for.
    """
    results = []
    for task in tasks:
        # The first scorer was warmed up in `_run`; all targets have one size.
        task.scorer.share_plan(tasks[0].scorer)
        if not (interrupted or interrupt.requested):
            task.polish()
        results.append(task.result(interrupted))
    return results


def _refuse_masks(groups: Iterable[str]) -> None:
    """Raise `ValueError` if one of `groups`, names in the option `freeze`, needs a mask.

    Those are `"vertices"` and `"triangles"`.
    """
    if any(group in steering.MASKED for group in groups):
        raise ValueError("`freeze` of a batch takes no masks: fit such targets one by one.")


def _check_targets(targets: Sequence[Any], transparent: bool) -> list[Image]:
    """Convert the targets to RGB or RGBA in 0..1; raise `ValueError` unless they have one shape.

    The shape includes the number of channels. `ValueError` is also raised for a target that is not
    an image, and if there are no targets.

    `transparent`: keep alpha, and add an alpha of 1 to each target without alpha. Otherwise alpha
    is dropped if it is 1 everywhere in all targets.
    """
    images = check_images(targets, transparent=transparent)
    shapes = {image.shape for image in images}
    if len(shapes) != 1:
        raise ValueError(f"`targets` must be images of one shape; got {sorted(shapes)}.")
    return images


def _settings(
    given: dict[str, Any],
    starts: list[Any],
    earlier: list[FitResult | None],
    steps: Any,
    seconds: Any,
) -> list[dict[str, Any]]:
    """Make the settings of each fit of a batch; raise `ValueError` if they are invalid.

    A fit that resumes a result has the settings of that result. Any other fit, at index k, has the
    given settings, its start, and the given seed plus k. The settings of all fits must be equal
    except for `seed` and `start`, because the fits share compiled programs. Resumed fits must be
    of layers, and must have taken equal numbers of steps.

    - `given`: the settings that the user gave, other than `start`. They are checked in any case.
    - `starts`: the start of each fit.
    - `earlier`: for each fit, the result that it resumes, or None.
    - `steps`, `seconds`: the limits, as in `fit`, which are only checked.
    """
    common = choices.normalize(given | {"start": None})
    choices.check(common, steps, seconds)
    settings = []
    for k, (start, result) in enumerate(zip(starts, earlier, strict=True)):
        each = common | {"seed": common["seed"] + k, "start": start}
        if result is not None:
            each = choices.normalize(settings_to_resume(each, result))
        settings.append(each)
    # All must share programs; seeds and starts are the only values that no program depends on.
    ignored = {"seed": 0, "start": None}
    if any(each | ignored != settings[0] | ignored for each in settings):
        raise ValueError("`resume` must be fits with the same settings.")
    if settings[0]["family"] != "layers":
        family = settings[0]["family"]
        raise ValueError(f"`resume` must be fits of layers; got those of a {family}.")
    steps_before = {
        result.history[-1].steps if result.history else 0 for result in earlier if result
    }
    if len(steps_before) > 1:
        raise ValueError("`resume` must be fits with equal numbers of steps.")
    return settings


def _for_each(name: str, value: Any, count: int) -> list[Any]:
    """Make a list with one value for each of `count` targets, from one value or one for each.

    - `name`: the argument's name, for the message of an error.
    - `value`: a sequence or array with one value for each target; or one value for all targets,
      which is None, a name, a scene or a mesh.

    Raises `ValueError` for a sequence of another length, and for any other value.
    """
    if value is None or isinstance(value, str | Scene | Mesh):
        return [value] * count
    is_array = isinstance(value, np.ndarray | jax.Array)
    is_sequence = isinstance(value, Sequence) or (is_array and value.ndim > 0)
    if not is_sequence or len(value) != count:
        got = f"{len(value)}" if is_sequence else f"{value!r:.60}"
        raise ValueError(f"`{name}` must be one for each of {count} targets; got {got}.")
    return list(value)


def _weight_maps(weights: Any, earlier: list[FitResult | None]) -> list[Any]:
    """Return, for each target, the weights of its pixels, or None for each if there are none.

    - `weights`: the argument of `fit_batch`, one map for all targets or one map for each. It is
      used for new fits only, whose weights are returned as they were given.
    - `earlier`: for each fit, the result that it resumes, or None. A fit that resumes a result has
      the weights in that result, which have been divided by their mean.

    Raises `ValueError` if only some of the targets have weights, or for another number of maps.
    """
    count = len(earlier)
    is_list = isinstance(weights, list | tuple) and len(weights) > 0 and np.ndim(weights[0]) != 1
    if is_list or (isinstance(weights, np.ndarray | jax.Array) and weights.ndim == 3):
        maps = _for_each("weights", weights, count)
    else:
        maps = [weights] * count
    maps = [
        weight_map if result is None else result.state.get("weights.given")
        for weight_map, result in zip(maps, earlier, strict=True)
    ]
    if len({weight_map is None for weight_map in maps}) > 1:
        raise ValueError("`weights` must be given for every target or for none.")
    return maps


def _run(
    tasks: list[Task],
    limits: Limits,
    report: Callable[[list[Record]], None] | None,
    stop: Callable[[], bool],
    devices: Devices | None,
) -> bool:
    """Run the chunks of all fits until their limits; return whether Ctrl-C ended the fits early.

    - `limits`: the limit of the call, in steps or seconds.
    - `report`: function that gets the last record of each fit after each chunk, or None.
    - `stop()`: returns whether Ctrl-C was pressed.
    - `devices`: as in `fit_batch`.
    """

    def report_records(share: float, seconds_left: float) -> None:
        if report is not None:
            report([task.history[-1] for task in tasks])

    first, count = tasks[0], len(tasks)
    warm_up = first.warm_up(limits.deadline is not None)
    with ThreadPoolExecutor(1) as pool:
        end_seconds = pool.submit(lambda: count * warm_up())
        budget = Budget(limits, end_seconds, first.seconds_before, count * END_SECONDS)
        return run(
            [task.fit for task in tasks], [task.history for task in tasks], budget,
            steps=first.steps_before, max_steps=first.max_steps, stop=stop, report=report_records,
            devices=devices,
        )  # fmt: skip
