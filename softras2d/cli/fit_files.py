"""Writes the files of `softras2d fit`.

This module imports JAX, so it is imported only while a command runs.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..color import premultiply
from ..comparison.pixels import on_white
from ..fitting.loop import ProgressReport
from ..fitting.result import FitResult
from ..fitting.score import Scorer
from ..fitting.target import Image
from ..io.animation import write_animation
from ..io.compact_scene import write_compact
from ..io.images import write_image
from ..io.svg.writing.browser_gradients import in_browsers
from ..io.svg.writing.writer import write_svg
from ..numerics.device import to_device
from ..options import Hard
from ..rendering.planner import plan
from ..rendering.render import render
from ..scene import Scene
from .fit_paths import COMPACT, STANDARD_STREAM

_MAX_FRAMES = 40
"""Largest number of frames of an animation of a fit, without its last frame.

Successive frames are at least 1/40 of the fit apart."""

_MAX_SIDE = 320
"""Largest number of pixels along the longer side of an animation."""


def write_all(
    paths: list[Path], result: FitResult, frames: "AnimationFrames | None", digits: int | None
) -> None:
    """Write every file of a fit, in the format that its suffix names.

    - `paths`: the files; `-` is an SVG on standard output.
    - `frames`: the frames of an animation; None if no GIF is written.
    - `digits`: number of decimals of coordinates in an SVG; None for exact numbers.

    If a file cannot be written, the others are still written. After that, a `ValueError` names all
    files that failed.
    """
    failures = []
    for path in paths:
        try:
            _write(path, result, frames, digits)
        except (ValueError, OSError, MemoryError) as error:
            message = " ".join(str(error).split())
            failures.append(message if str(path) in message else f"{path}: {message}")
    if failures:
        raise ValueError("; ".join(failures))


def _write(
    path: Path, result: FitResult, frames: "AnimationFrames | None", digits: int | None
) -> None:
    """Write one file of a fit, in the format that its suffix names; `-` is an SVG on stdout.

    The arguments are as in `write_all`.
    """
    if path == STANDARD_STREAM:
        with tempfile.TemporaryDirectory(prefix="softras2d-") as folder:
            file = Path(folder) / "fit.svg"
            _write(file, result, frames, digits)
            sys.stdout.buffer.write(file.read_bytes())
            sys.stdout.buffer.flush()
        return
    suffix = path.suffix.lower()
    if suffix == ".svg":
        height, width = result.height, result.width
        write_svg(path, result.scene, height=height, width=width, fallback=True, digits=digits)
    elif suffix == COMPACT:
        write_compact(path, result.scene, height=result.height, width=result.width)
    elif suffix == ".npz":
        result.save(path)
    elif suffix == ".json":
        result.write_report(path)
    elif suffix == ".gif":
        assert frames is not None
        frames.write(path, result.scene)
    else:
        write_image(path, result.image)


def size_note(path: Path, result: FitResult) -> str:
    """Text about the size of the compact file `path`, which is appended to the summary.

    It gives the bytes of the file, and the bits per pixel of the picture that was fitted.
    """
    size = path.stat().st_size
    bits = 8 * size / (result.height * result.width)
    return f"; {path} has {size} bytes, {bits:.3f} bits per pixel"


def browser_note(result: FitResult) -> str:
    """Text about how browsers show the SVG of a fit, which is appended to the summary.

    The PSNR in the text is estimated without a browser: the scene is drawn in the colours that the
    gradients of the SVG can express, and compared with the image of the fit. If the gradients
    express all colours exactly, the text says so instead.
    """
    note = "; a browser shows the SVG "
    shown = in_browsers(result.scene)
    if np.array_equal(shown.colors, result.scene.colors):
        return note + "in the same colours"
    psnr = Scorer(result.image).psnr(shown)
    return note + f"by linear gradients, {psnr:.1f} dB from this, antialiasing aside"


class AnimationFrames:
    """Collects scenes at about equal intervals during a fit, and writes them as a GIF.

    `size` is the (height, width) of the picture to fit, in pixels.
    """

    def __init__(self, size: tuple[int, int]):
        self._height, self._width = size
        self._scenes: list[tuple[float, Scene]] = []

    def add(self, report: ProgressReport) -> None:
        """Store the scene of a progress report, if it is time for another frame.

        That is so at the first report, and whenever another 1/40 of the fit (1/`_MAX_FRAMES`) has
        been done since the last frame.
        """
        if not self._scenes or report.share - self._scenes[-1][0] >= 1 / _MAX_FRAMES:
            self._scenes.append((report.share, report.scene()))

    def write(self, path: Path, last: Scene) -> None:
        """Draw the stored scenes, followed by the scene `last`, and write them as a GIF.

        The frames have the size of `small_images`. Each is shown for 0.1 s, and the last for 1.1 s.
        """
        scenes = [scene for _, scene in self._scenes]
        images = small_images(scenes, self._height, self._width) if scenes else []
        # The last scene has another number of triangles.
        write_animation(path, [*images, *small_images([last], self._height, self._width)])


def small_images(scenes: list[Scene], height: int, width: int) -> list[Image]:
    """Draw scenes as RGB images of at most `_MAX_SIDE` (320) pixels on the longer side.

    They are the frames of an animation. The scenes have arrays of equal shapes, and positions in
    pixels of a canvas of `height` x `width` pixels. A canvas that is smaller is not enlarged. Each
    pixel has 4 samples. A transparent background is composited over white. The images are floats
    `[rows, columns, 3]` in sRGB, 0..1.
    """
    scale = min(1.0, _MAX_SIDE / max(height, width))
    rows, columns = (max(1, round(side * scale)) for side in (height, width))
    scaled = [_scaled(scene, scale) for scene in scenes]
    # One plan for all compiles one program.
    shared = plan(scaled, height=rows, width=columns, coverage=Hard(4, edge_gradients=False))
    return [on_white(premultiply(np.asarray(render(scene, shared)))) for scene in scaled]


def _scaled(scene: Scene, scale: float) -> Scene:
    """Multiply the positions of a scene by `scale`."""
    return replace(scene, positions=to_device(np.asarray(scene.positions) * np.float32(scale)))
