"""Fits the frames of a film, for `softras2d fit --animation`.

This module imports JAX, so it is imported only while a command runs.
"""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..comparison.flicker import flicker
from ..fitting.frames import fit_frames
from ..fitting.result import FitResult
from ..fitting.target import Image
from ..io.animation import write_animation
from ..io.images import read_image
from ..io.svg.writing.film import write_svg_film
from .fit_bar import FitBar
from .fit_files import small_images
from .fit_options import FilmOptions

_FIRST_STEPS = 500
"""Number of solver steps of the first frame, unless `--steps` gives another number."""


def fit_film(
    frames: Sequence[Path],
    options: FilmOptions,
    settings: dict[str, Any],
    steps: int | None,
    bar: FitBar,
) -> tuple[list[FitResult], list[Image]]:
    """Read and fit the frames of a film; return a result for each frame, and the images read.

    - `frames`: the files of the frames, in order.
    - `options`: values of the options for films.
    - `settings`: arguments of `fit_frames` other than steps and those in `options`.
    - `steps`: solver steps of the first frame; None for `_FIRST_STEPS`.
    - `bar`: shows how many frames are done.

    After Ctrl-C, both lists end with the frame that was being fitted. Raises `ValueError` for
    frames of unequal sizes.
    """
    targets = read_frames(frames)

    def report(number: int, result: FitResult) -> None:
        status = f"frame {number + 1} of {len(targets)}, PSNR {result.psnr:.2f} dB"
        bar.advance((number + 1) / len(targets), status)

    results = fit_frames(
        targets, **settings, steps=_FIRST_STEPS if steps is None else steps,
        frame_steps=options.frame_steps, temporal=options.temporal, report=report,
    )  # fmt: skip
    return results, targets[: len(results)]


def read_frames(paths: Sequence[Path]) -> list[Image]:
    """Read the frames of a film, at least one, as images of one shape.

    If some frames have alpha, an alpha of 1 is added to the others. Raises `ValueError` for a frame
    that is not as large as the first.
    """
    images = [read_image(path) for path in paths]
    height, width = images[0].shape[:2]
    for path, image in zip(paths, images, strict=True):
        if image.shape[:2] != (height, width):
            raise ValueError(
                f"{path}: {image.shape[1]} x {image.shape[0]} pixels; the first frame, {paths[0]}, "
                f"has {width} x {height}."
            )
    # Some encoders leave out the alpha of opaque frames.
    channels = max(image.shape[2] for image in images)
    return [
        image if image.shape[2] == channels else np.dstack([image, np.ones_like(image[..., :1])])
        for image in images
    ]


def write_film(options: FilmOptions, results: Sequence[FitResult]) -> None:
    """Write the results of the frames as an animation: a GIF if the suffix is `.gif`, else SVG.

    The file is `options.animation`. The frames of a GIF have the size of `small_images`. In an SVG,
    coordinates have one decimal unless `options.digits` gives another number.
    """
    scenes = [result.scene for result in results]
    height, width = results[0].height, results[0].width
    if options.animation.suffix.lower() == ".gif":
        images = small_images(scenes, height, width)
        seconds = 1 / options.fps
        write_animation(
            options.animation, images, seconds_per_frame=seconds, hold_seconds=0.0
        )  # fmt: skip
        return
    digits = 1 if options.digits is None else options.digits
    write_svg_film(
        options.animation, scenes, height=height, width=width, seconds_per_frame=1 / options.fps,
        digits=digits,
    )  # fmt: skip


def film_summary(
    options: FilmOptions,
    results: Sequence[FitResult],
    targets: Sequence[Image],
    start_seconds: float,
) -> str:
    """Make the line about a film that is printed: its file, its scores, and the elapsed time.

    The line includes the flicker (see `comparison.flicker`), unless the film has one frame or no
    pixel that stands still.

    - `results`, `targets`: the result and the image of each frame.
    - `start_seconds`: when the process began, on the clock of `time.perf_counter`.
    """
    elapsed = time.perf_counter() - start_seconds
    psnr = float(np.mean([result.psnr for result in results]))
    changes = 255 * flicker([result.image for result in results], targets)
    frames = "1 frame" if len(results) == 1 else f"{len(results)} frames"
    still = "" if np.isnan(changes) else f", flicker {changes:.2f} levels of 255"
    return (
        f"{options.animation}: {frames}, {len(results[0].scene.triangles)} triangles, "
        f"mean PSNR {psnr:.2f} dB{still}, {options.animation.stat().st_size} bytes, "
        f"{elapsed:.1f} s, {elapsed / len(results):.2f} s a frame"
    )
