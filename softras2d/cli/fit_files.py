"""The files that `softras2d fit` writes. Imports JAX: for use within a command."""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..fitting.loop import ProgressReport
from ..fitting.result import FitResult
from ..fitting.score import Scorer
from ..io.animation import write_animation
from ..io.images import write_image
from ..io.svg.gradients import in_browsers
from ..io.svg.writer import write_svg
from ..numerics.device import to_device
from ..options import Hard
from ..rendering.planner import plan
from ..rendering.render import render
from ..scene import Scene
from .fit_paths import STANDARD

_MAX_FRAMES = 40
"""Scenes of the fit that an animation shows, before the last one."""

_MAX_SIDE = 320
"""Longer side of an animation, in pixels."""


def write_all(paths: list[Path], result: FitResult, frames: "AnimationFrames | None") -> None:
    """Write every file, also after one of them failed; then raise `ValueError` for those."""
    failures = []
    for path in paths:
        try:
            _write(path, result, frames)
        except (ValueError, OSError, MemoryError) as error:
            message = " ".join(str(error).split())
            failures.append(message if str(path) in message else f"{path}: {message}")
    if failures:
        raise ValueError("; ".join(failures))


def _write(path: Path, result: FitResult, frames: "AnimationFrames | None") -> None:
    """Write one file of a fit, in the format that its suffix names; `-` is an SVG on stdout."""
    if path == STANDARD:
        with tempfile.TemporaryDirectory(prefix="softras2d-") as folder:
            file = Path(folder) / "fit.svg"
            _write(file, result, frames)
            sys.stdout.buffer.write(file.read_bytes())
            sys.stdout.buffer.flush()
        return
    suffix = path.suffix.lower()
    if suffix == ".svg":
        scene, height, width = result.scene, result.height, result.width
        write_svg(path, scene, height=height, width=width, fallback=True)
    elif suffix == ".npz":
        result.save(path)
    elif suffix == ".json":
        result.write_report(path)
    elif suffix == ".gif":
        assert frames is not None
        frames.write(path, result.scene)
    else:
        write_image(path, result.image)


def browser_note(result: FitResult) -> str:
    """Describe how close the SVG in a browser comes to the fit; continues the line of scores.

    The number is an estimate made without a browser: the scene is drawn in the colours that the
    SVG's gradients can express.
    """
    note = "; a browser shows the SVG "
    shown = in_browsers(result.scene)
    if np.array_equal(shown.colors, result.scene.colors):
        return note + "in the same colours"
    psnr = Scorer(result.image).psnr(shown)
    return note + f"by linear gradients, {psnr:.1f} dB from this, antialiasing aside"


class AnimationFrames:
    """Scenes collected during a fit, evenly spaced over its duration, and drawn at its end."""

    def __init__(self, size: tuple[int, int]):
        self._height, self._width = size
        self._scenes: list[tuple[float, Scene]] = []

    def add(self, moment: ProgressReport) -> None:
        """Keep the current scene if the fit has advanced by one frame since the last one kept."""
        if not self._scenes or moment.share - self._scenes[-1][0] >= 1 / _MAX_FRAMES:
            self._scenes.append((moment.share, moment.scene()))

    def write(self, path: Path, last: Scene) -> None:
        """Write the animation, which ends with the scene `last`."""
        scale = min(1.0, _MAX_SIDE / max(self._height, self._width))
        height, width = (max(1, round(side * scale)) for side in (self._height, self._width))
        scenes = [_scaled(scene, scale) for _, scene in self._scenes]
        hard = Hard(samples=4, edge_gradients=False)
        frames = []
        if scenes:
            # Scenes during a fit have equal shapes, so that one plan compiles one program for all.
            shared = plan(scenes, height=height, width=width, coverage=hard)
            frames = [np.asarray(render(scene, shared))[..., :3] for scene in scenes]
        end = _scaled(last, scale)
        final = render(end, plan(end, height=height, width=width, coverage=hard))
        write_animation(path, [*frames, np.asarray(final)[..., :3]])


def _scaled(scene: Scene, scale: float) -> Scene:
    return replace(scene, positions=to_device(np.asarray(scene.positions) * np.float32(scale)))
