"""The result of a fit, and the files in which it is saved."""

import json
import os
import platform
from dataclasses import dataclass, field, fields
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from .. import __version__
from ..display.leaves import field_of, size_of
from ..display.notebook import image_html
from ..display.words import count_text, number_text
from ..io.drafts import atomic_file
from ..scene import Scene
from . import saved_fit
from .archive import MAX_BYTES, read_arrays
from .entries import Entries, Size


class Record(NamedTuple):
    """The state of a fit after a chunk of steps.

    - `steps`, `seconds`: numbers of steps and seconds since the fit began, including those of the
      fits that were resumed.
    - `psnr` (dB), `ssim`: scores of the image of the last step against the target, from sRGB
      values, premultiplied if there is alpha, at the size and with the coverage of the fit.
    - `accepted`: number of steps, of `steps`, whose loss was below all earlier losses in the same
      call of `fit`.
    - `active`: number of triangles in use.
    """

    steps: int
    seconds: float
    psnr: float
    ssim: float
    accepted: int
    active: int


@dataclass(frozen=True)
class FitResult:
    """A fitted scene, its scores, and the history of the fit.

    - `scene`: in pixels of the target.
    - `image`: the scene drawn in hard mode with 16 samples per pixel, `[height, width, channels]`,
      with straight alpha.
    - `psnr` (dB; infinite if equal), `ssim`: scores of `image` against the target, from sRGB
      values, which are premultiplied if there is alpha. `fit` says what a checkpoint has as `image`
      and scores after a second Ctrl-C.
    - `history`: one record for each chunk of steps, including those of the fits that were resumed.
    - `settings`: the arguments of the fit, in types that JSON has.
    - `interrupted`: whether Ctrl-C ended the fit.
    - `state`: arrays by name, from which `fit(..., resume=)` continues; empty if it cannot.
    """

    scene: Scene
    image: np.ndarray
    psnr: float
    ssim: float
    history: tuple[Record, ...]
    settings: dict[str, Any]
    interrupted: bool = False
    state: dict[str, np.ndarray] = field(default_factory=dict)

    def __repr__(self) -> str:
        psnr, ssim = number_text(self.psnr, 2), number_text(self.ssim, 3)
        triangles = size_of(field_of(self.scene, "triangles"), -2)
        size = f"{size_of(self.image, -2)} x {size_of(self.image, -3)} px"
        facts = [count_text(triangles, "triangle"), size]
        if self.history:
            last = self.history[-1]
            facts.append(f"{count_text(last.steps, 'step')} in {number_text(last.seconds, 1)} s")
        facts += ["interrupted"] * bool(self.interrupted)
        return f"FitResult: PSNR {psnr} dB, SSIM {ssim}\n  {', '.join(facts)}"

    def _repr_html_(self) -> str | None:
        """HTML of the fitted image above the text of `repr`, for notebooks."""
        return image_html(self.image, repr(self))

    @property
    def height(self) -> int:
        """Height of the target, in pixels."""
        return self.image.shape[0]

    @property
    def width(self) -> int:
        """Width of the target, in pixels."""
        return self.image.shape[1]

    def report(self) -> dict[str, Any]:
        """Return settings, scores, history, versions and machine, in types that JSON has.

        The keys are `settings`, `height`, `width` (in pixels), `triangles` (their number), `psnr`
        (dB), `ssim`, `steps`, `seconds`, `interrupted`, `versions`, `machine` and `history`, a list
        of records as dictionaries. Numbers that are not finite, such as the PSNR of equal
        images, are None.
        """
        last = self.history[-1] if self.history else Record(0, 0.0, -np.inf, 0.0, 0, 0)
        return {
            "settings": self.settings,
            "height": self.height,
            "width": self.width,
            "triangles": self.scene.triangles.shape[0],
            "psnr": _plain(self.psnr),
            "ssim": _plain(self.ssim),
            "steps": last.steps,
            "seconds": last.seconds,
            "interrupted": self.interrupted,
            "versions": {
                "softras2d": __version__,
                "python": platform.python_version(),
                **{name: metadata.version(name) for name in _LIBRARIES},
            },
            "machine": {
                "system": platform.system(),
                "processor": platform.machine(),
                "cores": os.cpu_count(),
                "device": jax.devices()[0].device_kind,
            },
            "history": [
                {name: _plain(value) for name, value in record._asdict().items()}
                for record in self.history
            ],
        }

    def write_report(self, path: str | os.PathLike[str]) -> None:
        """Write what `report` returns as a JSON file. A failure leaves no partial file."""
        text = json.dumps(self.report(), indent=1) + "\n"
        path = Path(path)
        with atomic_file(path) as draft:
            draft.write_text(text, encoding="utf-8")

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write an `.npz` file from which `load` restores the result exactly.

        A failure leaves no partial file. Raises `ValueError`, with a message of one line, for
        another suffix (either case will do), for a result whose arrays have more than a GiB, and
        for a file that cannot be written.
        """
        path = Path(path)
        if path.suffix.lower() != ".npz":
            raise ValueError(f"{path}: the suffix must be .npz.")
        facts = {
            "format": saved_fit.FORMAT,
            "settings": self.settings,
            "interrupted": self.interrupted,
        }
        arrays = {
            "image": self.image,
            "facts": np.frombuffer(json.dumps(facts).encode(), np.uint8),
            "scores": np.array([self.psnr, self.ssim]),
            "history": np.array([tuple(map(float, row)) for row in self.history]).reshape(-1, 6),
        }
        for entry in saved_fit.SCENE_FIELDS:
            arrays[f"scene.{entry}"] = np.asarray(getattr(self.scene, entry))
        for name, value in self.state.items():
            arrays[f"{_STATE}{name}"] = np.asarray(value)
        size = sum(array.nbytes for array in arrays.values())
        if size > MAX_BYTES:
            raise ValueError(f"{path}: a fit of {size} bytes is too large; {MAX_BYTES} at most.")
        with atomic_file(path) as draft, draft.open("wb") as file:
            np.savez_compressed(file, **arrays)  # pyright: ignore[reportArgumentType]

    @staticmethod
    def load(path: str | os.PathLike[str]) -> "FitResult":
        """Read a file that `save` wrote. Every array is checked before it is used.

        Raises `ValueError` for any other file, and for one that unpacks to more than a GiB. The
        message, one line, names the file and, if a single array is at fault, that array.
        """
        path = Path(path)
        if not path.is_file():
            raise ValueError(f"{path}: no such file.")
        arrays = read_arrays(path)
        try:
            return _result(arrays)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None


_LIBRARIES = ("jax", "jaxlib", "equinox", "lineax", "optax", "optimistix", "numpy", "scipy")

_STATE = "state."
"""Prefix of the names of the arrays in a file that belong to `FitResult.state`."""

assert set(saved_fit.SCENE_FIELDS) < {scene_field.name for scene_field in fields(Scene)}


def _result(arrays: dict[str, np.ndarray]) -> FitResult:
    """Make the result from the arrays of a file, by name; raise `ValueError` if one is invalid."""
    state = {
        name.removeprefix(_STATE): value
        for name, value in arrays.items()
        if name.startswith(_STATE)
    }
    entries = Entries({k: v for k, v in arrays.items() if not k.startswith(_STATE)})
    settings, interrupted = saved_fit.read_facts(entries)
    image = saved_fit.read_image(entries)
    psnr, ssim = saved_fit.read_scores(entries)
    history = tuple(_record(row) for row in saved_fit.read_history(entries, Record._fields))
    scene = saved_fit.read_scene(entries, settings, image.shape[2])
    entries.end()
    if state:
        steps = history[-1].steps if history else 0
        saved_fit.check_state(state, settings, Size(*image.shape), steps)
    return FitResult(scene, image, psnr, ssim, history, settings, interrupted, state)


def _record(row: Float[np.ndarray, "6"]) -> Record:
    """Make a record from a row of the saved history, which has its fields in order."""
    steps, seconds, psnr, ssim, accepted, active = map(float, row)
    return Record(int(steps), seconds, psnr, ssim, int(accepted), int(active))


def _plain(value: Any) -> Any:
    """Replace a float that is not finite by None, because JSON has no infinity and no NaN."""
    return None if isinstance(value, float) and not np.isfinite(value) else value
