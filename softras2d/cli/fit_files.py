"""The files that `softras2d fit` writes. Imports JAX: for use within a command."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..fitting.loop import Moment
from ..fitting.result import FitResult
from ..fitting.score import Scorer
from ..fitting.target import Image
from ..io.animation import write_animation
from ..io.images import WRITABLE, check_place, write_image
from ..io.svg.gradients import in_browsers
from ..io.svg.writer import write_svg
from ..numerics.device import to_device
from ..options import Hard
from ..planning.plan import plan
from ..rendering.render import render
from ..scene import Scene

_KNOWN = (".svg", *WRITABLE, ".gif", ".npz", ".json")

_FRAMES, _SIDE = 40, 320
"""Pictures of a film at most, and their longer side in pixels."""


def check_outputs(paths: list[Path], given: dict[Path, str], picture: Image) -> None:
    """Raise `ValueError` for a file that could not be written, before the work of a fit.

    `given`: files that are read and are to stay, and what they are; `picture`: what is fitted.
    """
    clear = picture.shape[-1] == 4 and bool((picture[..., 3] < 1).any())
    for path in paths:
        if path.suffix.lower() not in _KNOWN:
            raise ValueError(f"{path}: the suffix must be one of {', '.join(_KNOWN)}.")
        check_place(path)
        if not os.access(path.parent, os.W_OK):
            raise ValueError(f"{path}: the folder {path.parent} cannot be written to.")
        if clear and path.suffix.lower() in (".jpg", ".jpeg"):
            raise ValueError(f"{path}: JPEG holds no alpha, and the picture to fit has it.")
        for own, name in given.items():
            if path.exists() and own.exists() and path.samefile(own):
                raise ValueError(f"{path}: that is {name}.")
    if len(set(paths)) < len(paths):
        raise ValueError("the same --output is given twice.")


def write_all(paths: list[Path], result: FitResult, film: "Film | None") -> None:
    """Every file; one that fails keeps no other from being written. Raises `ValueError`."""
    failed = []
    for path in paths:
        try:
            write(path, result, film)
        except (ValueError, OSError, MemoryError) as error:
            told = " ".join(str(error).split())
            failed.append(told if str(path) in told else f"{path}: {told}")
    if failed:
        raise ValueError("; ".join(failed))


def write(path: Path, result: FitResult, film: "Film | None") -> None:
    """One file of a fit, by its suffix."""
    suffix = path.suffix.lower()
    if suffix == ".svg":
        scene, height, width = result.scene, result.height, result.width
        write_svg(path, scene, height=height, width=width, fallback=True)
    elif suffix == ".npz":
        result.save(path)
    elif suffix == ".json":
        result.write_report(path)
    elif suffix == ".gif":
        assert film is not None
        film.write(path, result.scene)
    else:
        write_image(path, result.image)


def told_of_browsers(result: FitResult) -> str:
    """How far the SVG's picture in a browser is from the fit's, to be put after its scores.

    An estimate without a browser: the scene is drawn in the colours that the gradients reach.
    """
    told = "; a browser shows the SVG "
    shown = in_browsers(result.scene)
    if np.array_equal(shown.colors, result.scene.colors):
        return told + "in the same colours"
    psnr = Scorer(result.image).score(shown).psnr
    return told + f"by linear gradients, {psnr:.1f} dB from this, antialiasing aside"


class Film:
    """Scenes of a fit, some of them kept, to be drawn at the end."""

    def __init__(self, size: tuple[int, int]):
        self._height, self._width = size
        self._scenes: list[tuple[float, Scene]] = []

    def add(self, moment: Moment) -> None:
        """Keep the scene if enough has happened since the last one kept."""
        if not self._scenes or moment.share - self._scenes[-1][0] >= 1 / _FRAMES:
            self._scenes.append((moment.share, moment.scene()))

    def write(self, path: Path, last: Scene) -> None:
        """The film; it ends with the last scene."""
        scale = min(1.0, _SIDE / max(self._height, self._width))
        height, width = (max(1, round(side * scale)) for side in (self._height, self._width))
        scenes = [_shrunk(scene, scale) for _, scene in self._scenes]
        hard = Hard(samples=4, edge_gradients=False)
        # One plan for those of one size: one program.
        frames = []
        if scenes:
            shared = plan(scenes, height=height, width=width, coverage=hard)
            frames = [np.asarray(render(scene, shared))[..., :3] for scene in scenes]
        end = _shrunk(last, scale)
        final = render(end, plan(end, height=height, width=width, coverage=hard))
        write_animation(path, [*frames, np.asarray(final)[..., :3]])


def _shrunk(scene: Scene, scale: float) -> Scene:
    return replace(scene, positions=to_device(np.asarray(scene.positions) * np.float32(scale)))
