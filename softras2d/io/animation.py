"""Animations out, as GIF: into PNG and WebP OpenImageIO (3.2) writes one image only."""

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from . import gif
from .drafts import atomic_file
from .images import as_pixels, check_writable_path, to_bytes
from .palette import quantized

ANIMATED = (".gif",)
"""Suffixes that `write_animation` knows."""

_SHORTEST = 2
"""Hundredths of a second; browsers show shorter frames for ten."""


def write_animation(
    path: str | os.PathLike[str],
    frames: Iterable[Any],
    *,
    seconds_per_frame: float = 0.1,
    hold_seconds: float = 1.0,
) -> None:
    """Write float frames `[height, width, 3]`, all of one size, as a GIF that repeats endlessly.

    Frames are sRGB and clipped to 0..1, as in `write_image`; they may come from a generator, of
    which two are held at a time. Times are rounded to 1/100 s; the last frame stays `hold_seconds`
    longer than the others. A frame has 256 colours: exact if it needs no more, else from a palette
    of its own, not dithered, so that wide smooth gradients show bands. Only the rectangle that
    changes is stored.

    The file appears whole or not at all. Raises `ValueError`, one line, for another suffix, a
    folder that is not there, times that GIF cannot say, no frames, and a frame of another shape or
    dtype or with values that are not finite.
    """
    path = Path(path)
    if path.suffix.lower() not in ANIMATED:
        raise ValueError(f"{path}: the suffix must be {' or '.join(ANIMATED)}.")
    check_writable_path(path)
    delay = _hundredths("seconds_per_frame", seconds_per_frame, _SHORTEST)
    last_delay = delay + _hundredths("hold_seconds", hold_seconds, 0)
    if last_delay > gif.LONGEST:
        raise ValueError(
            "`seconds_per_frame` and `hold_seconds` together must be at most "
            f"{gif.LONGEST / 100}; got {last_delay / 100}."
        )
    with atomic_file(path) as draft, draft.open("wb") as file:
        shown = None
        for image, is_last in _marked(_images(path, frames)):
            if shown is None:
                file.write(gif.header(*image.shape[:2]))
            file.write(_frame(image, shown, last_delay if is_last else delay))
            shown = image
        file.write(gif.TRAILER)


def _hundredths(name: str, seconds: float, least: int) -> int:
    # Written so that NaN is refused too.
    if not least / 100 <= seconds <= gif.LONGEST / 100:
        raise ValueError(
            f"`{name}` must be {least / 100} to {gif.LONGEST / 100} in a GIF; got {seconds}."
        )
    return round(100 * seconds)


def _images(path: Path, frames: Iterable[Any]) -> Iterator[UInt8[np.ndarray, "height width 3"]]:
    """The frames in bytes, checked one by one."""
    shape = None
    for number, frame in enumerate(frames):
        where = f"{path}: frame {number}"
        image = np.asarray(frame)
        if image.ndim != 3 or image.shape[2] != 3:
            raise ValueError(f"{where}: a frame is [height, width, 3]; got {image.shape}.")
        if image.shape != (shape or image.shape):
            raise ValueError(f"{where}: is {image.shape}; wanted {shape}, as frame 0 is.")
        if max(image.shape) > gif.LARGEST_SIDE:
            raise ValueError(f"{where}: a GIF has at most {gif.LARGEST_SIDE} pixels a side.")
        shape = image.shape
        yield to_bytes(as_pixels(where, image))
    if shape is None:
        raise ValueError(f"{path}: there are no frames; at least one is wanted.")


def _marked(images: Iterator[np.ndarray]) -> Iterator[tuple[np.ndarray, bool]]:
    """Each image, and whether it is the last."""
    held = next(images)
    for image in images:
        yield held, False
        held = image
    yield held, True


def _frame(image: np.ndarray, shown: np.ndarray | None, delay: int) -> bytes:
    """The smallest rectangle that turns `shown` into `image`; one pixel if nothing changes."""
    if shown is None:
        changed = np.ones(image.shape[:2], bool)
    else:
        changed = (image != shown).any(axis=2)
        changed[0, 0] |= not changed.any()
    rows, columns = (np.flatnonzero(changed.any(axis=axis)) for axis in (1, 0))
    top, left = int(rows[0]), int(columns[0])
    indices, palette = quantized(image[top : rows[-1] + 1, left : columns[-1] + 1])
    return gif.frame(indices, palette, top=top, left=left, delay=delay)
