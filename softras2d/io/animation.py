"""Writes animations as GIF.

Other formats would need another library, since OpenImageIO (3.2) writes only one image into a PNG
or WebP.
"""

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from . import gif
from .drafts import atomic_file
from .outputs import check_writable_path
from .palette import quantized
from .pixel_values import as_pixels, to_bytes

ANIMATED = (".gif",)
"""Suffixes that `write_animation` accepts in either case, listed in lower case."""

_MIN_DELAY = 2
"""Minimum time of a frame, in hundredths of a second.

Browsers show shorter frames for 0.1 s.
"""


def write_animation(
    path: str | os.PathLike[str],
    frames: Iterable[Any],
    *,
    seconds_per_frame: float = 0.1,
    hold_seconds: float = 1.0,
) -> None:
    """Write frames `[height, width, 3]` of equal size as a GIF that repeats endlessly.

    - `frames`: float images in sRGB, clipped to 0..1. They may come from a generator; only a
      few of them are in memory at a time.
    - `seconds_per_frame`: time of each frame, at least 0.02, rounded to 1/100 s.
    - `hold_seconds`: additional time of the last frame, rounded to 1/100 s, at least 0. The last
      frame is shown for 655.35 s at most.

    Of each frame, only the smallest rectangle around all pixels that differ from the frame before
    is stored. A rectangle has a palette of 256 colours. If the rectangle has at most 256 colours,
    they are exact; otherwise they are reduced without dithering, so that wide smooth gradients show
    bands.

    The file is written completely or not at all. Raises `ValueError`, one line, for a suffix other
    than `.gif`, a folder that does not exist, times out of range, no frames, frames that are not
    `[height, width, 3]`, are empty, differ in shape or have a side of more than 65535 pixels,
    values that are not finite floats, and a file that cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() not in ANIMATED:
        raise ValueError(f"{path}: the suffix must be {' or '.join(ANIMATED)}.")
    check_writable_path(path)
    delay = _hundredths("seconds_per_frame", seconds_per_frame, _MIN_DELAY)
    last_delay = delay + _hundredths("hold_seconds", hold_seconds, 0)
    if last_delay > gif.MAX_DELAY:
        raise ValueError(
            "`seconds_per_frame` and `hold_seconds` together must be at most "
            f"{gif.MAX_DELAY / 100} seconds; got {last_delay / 100}."
        )
    with atomic_file(path) as draft, draft.open("wb") as file:
        previous = None
        for image, is_last in _mark_last(_checked_bytes(path, frames)):
            if previous is None:
                file.write(gif.header(*image.shape[:2]))
            file.write(_encode_changed_rectangle(image, previous, last_delay if is_last else delay))
            previous = image
        file.write(gif.TRAILER)


def _hundredths(name: str, seconds: float, least: int) -> int:
    """Round seconds to whole hundredths of a second.

    Raises `ValueError`, whose message names the argument as `name`, if `seconds` is NaN, less than
    `least` hundredths or more than `gif.MAX_DELAY` hundredths.
    """
    # Written so that NaN is refused too.
    if not least / 100 <= seconds <= gif.MAX_DELAY / 100:
        raise ValueError(
            f"`{name}` must be {least / 100} to {gif.MAX_DELAY / 100} seconds; got {seconds}."
        )
    return round(100 * seconds)


def _checked_bytes(path: Path, frames: Iterable[Any]) -> Iterator[np.ndarray]:
    """Check frames one by one; yields each as sRGB bytes, `[height, width, 3]`.

    Values are clipped to 0..1 and rounded to k/255. Raises `ValueError`, which names `path` and the
    index of the frame, for a frame that is not `[height, width, 3]` of finite floats, is empty, is
    too large for a GIF, or differs in shape from the first frame. If there are no frames, raises
    `ValueError` that names `path`.
    """
    shape = None
    for number, frame in enumerate(frames):
        name = f"{path}: frame {number}"
        image = np.asarray(frame)
        if image.ndim != 3 or image.shape[2] != 3:
            raise ValueError(f"{name}: a frame is [height, width, 3]; got {image.shape}.")
        if image.shape != (shape or image.shape):
            raise ValueError(f"{name}: must have the shape of frame 0, {shape}; got {image.shape}.")
        if max(image.shape) > gif.MAX_SIDE:
            raise ValueError(f"{name}: a GIF has at most {gif.MAX_SIDE} pixels a side.")
        shape = image.shape
        yield to_bytes(as_pixels(name, image))
    if shape is None:
        raise ValueError(f"{path}: there are no frames; an animation needs at least one.")


def _mark_last(images: Iterator[np.ndarray]) -> Iterator[tuple[np.ndarray, bool]]:
    """Yield each image, and whether it is the last. There must be at least one image."""
    image = next(images)
    for following in images:
        yield image, False
        image = following
    yield image, True


def _encode_changed_rectangle(
    image: UInt8[np.ndarray, "height width 3"],
    previous: UInt8[np.ndarray, "height width 3"] | None,
    delay: int,
) -> bytes:
    """Encode the smallest rectangle that turns `previous` into `image`, as a frame of a GIF.

    The rectangle is the complete image if `previous` is None, and the pixel at the top left if both
    images are equal. Its colours are reduced to 256. `delay` is the time for which the frame is
    shown, in hundredths of a second.
    """
    if previous is None:
        is_changed = np.ones(image.shape[:2], bool)
    else:
        is_changed = (image != previous).any(axis=2)
        # A frame draws at least one pixel.
        is_changed[0, 0] |= not is_changed.any()
    rows, columns = (np.flatnonzero(is_changed.any(axis=axis)) for axis in (1, 0))
    top, left = int(rows[0]), int(columns[0])
    indices, palette = quantized(image[top : rows[-1] + 1, left : columns[-1] + 1])
    return gif.frame(indices, palette, top=top, left=left, delay=delay)
