"""Fit all pictures of a folder: group the pictures in batches, and write the files of each picture.

Pictures have many sizes, and a program is compiled for each size of fit. So every picture is shrunk
to a size class first: its longer side is a power of two (or the size of the fit), and its shorter
side a multiple of a sixteenth of that. The fitted scene is stretched back to the picture's size.

Pictures of one size class are fitted in batches of a fixed number. Which pictures share a batch
depends on the folder, the size of the fit and that number alone. It does not depend on which
pictures are fitted already, or on how many processes share the work. Neither do the results depend
on that, if the limit is a number of steps.
"""

import json
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from ..io.drafts import atomic_file
from ..io.images import image_size, read_image
from ..io.svg.writing.writer import write_svg
from ..numerics.device import Devices, to_device
from .batch import fit_batch
from .resample import shrink
from .result import FitResult
from .target import Image

SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".exr", ".bmp", ".webp", ".gif")
"""Suffixes of the files in a folder that count as pictures; upper case counts, too."""

_SHARES = 16
"""Number of aspect ratios of size classes: the shorter side is 1/16, 2/16, ... or 16/16 of the
longer side."""


class SizeClass(NamedTuple):
    """A size of fit, in pixels, to which pictures of about the same aspect ratio are shrunk."""

    height: int
    width: int


class Batch(NamedTuple):
    """Pictures that are fitted together, by one call of `fit_batch`.

    - `number`: index of the batch in the list that `make_batches` returns.
    - `size`: the size in pixels to which its pictures are shrunk.
    - `pictures`: the files of the pictures.
    - `first_index`: index of its first picture among the pictures of all batches. The seed of a
      picture's fit is the seed of the command plus the index of the picture.
    """

    number: int
    size: SizeClass
    pictures: tuple[Path, ...]
    first_index: int


_REPORTED = ("triangles", "solver", "size", "seed", "steps", "seconds")
"""Settings of `fit_pictures` that reports hold, so that a later command can compare its own."""


class Fitted(NamedTuple):
    """A picture whose files are written, and its scores at the size of the fit.

    - `psnr`: in dB.
    - `ssim`: structural similarity, in -1..1.
    - `settings`: the settings of its fit, by name (`_REPORTED`), of which some may be missing.
      `seed` is the seed of the command.
    """

    picture: Path
    psnr: float
    ssim: float
    settings: Mapping[str, Any]


def size_class(height: int, width: int, size: int) -> SizeClass:
    """Choose the size class to which a picture is shrunk, of about the picture's aspect ratio.

    The longer side of the class is `size` or a power of two below `size`: the largest of these
    numbers that does not exceed the longer side of the picture. The shorter side is k sixteenths of
    the longer one, rounded down, where k is 16 times the aspect ratio of the picture (shorter by
    longer side), rounded down, and at least 1. The shorter side is at least 1 pixel, and at most
    the shorter side of the picture.

    - `height`, `width`: size of the picture in pixels.
    - `size`: largest number of pixels along the longer side of the class.
    """
    longer, shorter = max(height, width), min(height, width)
    side = size
    while side > longer:
        # Powers of two below a size that need not be one.
        side = 1 << ((side - 1).bit_length() - 1)
    share = max(shorter * _SHARES // longer, 1)
    other = max(min(side * share // _SHARES, shorter), 1)
    return SizeClass(side, other) if height >= width else SizeClass(other, side)


def find_pictures(folder: Path) -> list[Path]:
    """List the picture files of a folder, sorted by name.

    Folders and hidden files, whose names begin with a dot, are left out.

    Raises `ValueError` if the folder does not exist or has no picture, and if the names of two
    pictures differ in the suffix alone, since the results of both would have the same file names.
    """
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder.")
    pictures = sorted(
        path
        for path in folder.iterdir()
        if path.suffix.lower() in SUFFIXES and not path.name.startswith(".") and path.is_file()
    )
    if not pictures:
        raise ValueError(f"{folder}: no pictures in this folder ({', '.join(SUFFIXES)}).")
    names: dict[str, str] = {}
    for picture in pictures:
        if picture.stem in names:
            raise ValueError(f"{picture}: its files would replace those of {names[picture.stem]}.")
        names[picture.stem] = picture.name
    return pictures


def make_batches(
    pictures: Sequence[Path], size: int, count: int, fail: Callable[[str], None]
) -> list[Batch]:
    """Group pictures by size class, and divide each group into batches of at most `count` pictures.

    - `size`: largest number of pixels along the longer side of a fit.
    - `fail(line)`: called with a message of one line for each picture that cannot be read. Such a
      picture is in no batch.
    """
    groups: defaultdict[SizeClass, list[Path]] = defaultdict(list)
    for picture in pictures:
        try:
            groups[size_class(*image_size(picture), size)].append(picture)
        except ValueError as error:
            fail(str(error))
    batches, index = [], 0
    for kind in sorted(groups):
        for first in range(0, len(groups[kind]), count):
            members = tuple(groups[kind][first : first + count])
            batches.append(Batch(len(batches), kind, members, index))
            index += len(members)
    return batches


def fit_pictures(
    batch: Batch,
    folder: Path,
    *,
    count: int,
    seed: int,
    fail: Callable[[str], None],
    compiles_first: bool = False,
    devices: Devices | None = None,
    **settings: Any,
) -> Iterator[Fitted]:
    """Fit the pictures of a batch, and write the results that do not exist in `folder` yet.

    - `folder`: folder of the results. The files of NAME.jpg are NAME.svg and then NAME.json.
    - `count`: number of fits in every batch. A batch with fewer pictures is filled up with copies
      of its first readable picture, so that all batches of a size class share a program.
    - `seed`: the seed of the command; see `Batch.first_index`.
    - `fail(line)`: called with a message of one line for each picture that cannot be read.
    - `compiles_first`: whether programs are compiled before the fit, by a fit of one step, so that
      a limit of `seconds` counts fitting alone.
    - `devices`: as in `fit_batch`.
    - `settings`: other arguments of `fit_batch`. `size` should be that of `make_batches`.

    Yields the scores of each picture as soon as both of its files are written. A picture that had
    both files before is not yielded, and its files are not written. Raises `KeyboardInterrupt`
    after Ctrl-C during the fit, without writing.
    """
    wanted = [picture for picture in batch.pictures if not is_done(picture, folder)]
    if not wanted:
        return
    images: dict[Path, Image] = {}
    for picture in batch.pictures:
        try:
            images[picture] = shrunken(read_image(picture), batch.size)
        except ValueError as error:
            fail(str(error))
    if not images:
        return
    substitute = next(iter(images.values()))
    targets = [images.get(picture, substitute) for picture in batch.pictures]
    targets += [substitute] * (count - len(targets))
    reported = settings | {"seed": seed}
    reported = {name: reported[name] for name in _REPORTED if name in reported}
    settings = settings | {"seed": seed + batch.first_index, "devices": devices}
    if compiles_first:
        one_step: dict[str, Any] = settings | {"steps": 1, "seconds": None}
        if fit_batch(targets, **one_step)[0].interrupted:
            raise KeyboardInterrupt
    results = fit_batch(targets, **settings)
    if results[0].interrupted:
        raise KeyboardInterrupt
    for index, picture in enumerate(batch.pictures):
        if picture in images and picture in wanted:
            result, own_seed = results[index], seed + batch.first_index + index
            _write(result, picture, folder, own_seed, reported)
            yield Fitted(picture, result.psnr, result.ssim, reported)


def is_done(picture: Path, folder: Path) -> bool:
    """Whether `folder` has both files of a fitted picture, NAME.svg and NAME.json."""
    return all((folder / f"{picture.stem}{suffix}").is_file() for suffix in (".svg", ".json"))


def read_fitted(picture: Path, folder: Path) -> Fitted:
    """Read the scores and settings of a picture that was fitted before, from its report NAME.json.

    `folder` has the report, which must exist. In reports of older versions, the only setting is the
    number of triangles. Raises `ValueError` if the file is not such a report.
    """
    path = folder / f"{picture.stem}.json"
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        settings = {"triangles": report["triangles"], **report.get("settings", {})}
        return Fitted(picture, float(report["psnr"]), float(report["ssim"]), settings)
    except (ValueError, KeyError, TypeError):
        raise ValueError(f"{path}: not a report of a fit; remove it.") from None


def changed_settings(fitted: Fitted, settings: Mapping[str, Any]) -> list[str]:
    """Names of the settings with which a picture was fitted that now have other values.

    Settings that are missing in `fitted` do not count. `settings`: the current values of all
    settings that reports hold, by name.
    """
    return [
        name
        for name in _REPORTED
        if name in fitted.settings and fitted.settings[name] != settings[name]
    ]


def shrunken(
    image: Float[np.ndarray, "rows columns channels"], size: SizeClass
) -> Float[np.ndarray, "height width 3"]:
    """Composite a picture over white if it has alpha, and shrink it to its size class.

    `image`: sRGB values with straight alpha, which are composited and averaged as they are.
    """
    if image.shape[-1] == 4:
        alpha = image[..., 3:]
        image = image[..., :3] * alpha + (1 - alpha)
    return shrink(image.astype(np.float32), size.height, size.width)


def _write(
    result: FitResult, picture: Path, folder: Path, seed: int, settings: Mapping[str, Any]
) -> None:
    """Write the files NAME.svg and NAME.json of a fitted picture to `folder`.

    - `result`: the fit at the size of its batch. In the SVG it is stretched to the picture's size.
    - `seed`: the seed of this picture's fit.
    - `settings`: the settings that the report holds (`_REPORTED`).

    The JSON file has no times, so that the same fit writes the same bytes.
    """
    height, width = image_size(picture)
    factors = np.array([[width / result.width, height / result.height]], np.float32)
    positions = to_device(np.asarray(result.scene.positions) * factors)
    scene = replace(result.scene, positions=positions)
    write_svg(folder / f"{picture.stem}.svg", scene, height=height, width=width, fallback=True)
    report = {
        "picture": picture.name,
        "height": height,
        "width": width,
        "fitted_height": result.height,
        "fitted_width": result.width,
        "triangles": result.scene.triangles.shape[0],
        "steps": result.history[-1].steps if result.history else 0,
        "seed": seed,
        "psnr": result.psnr,
        "ssim": result.ssim,
        "settings": settings,
    }
    with atomic_file(folder / f"{picture.stem}.json") as draft:
        draft.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")
