"""The function `assert_image_matches`, which compares an image with a reference PNG."""

import os
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32

from ..comparison.compare import compare
from ..comparison.pixels import comparable_pixels, pixel_difference
from ..comparison.tolerance import ONE_LEVEL, checked_tolerance, exceeds
from ..io.images import read_image, write_image
from ..io.pixel_values import as_pixels, round_to_levels

FAILURES = "failures"
"""Name of the folder, beside a reference, into which the images of a failed assertion are saved."""


def assert_image_matches(
    image: Any,
    path: str | os.PathLike[str],
    *,
    tolerance: int | float = ONE_LEVEL,
    update: bool = False,
) -> None:
    """Assert that no pixel of an image differs from a reference PNG by more than the tolerance.

    - `image`: floats `[height, width, channels]` in 0..1, of NumPy or JAX, in sRGB, with 1, 3 or 4
      channels. It is rounded to 8 bits first, as the reference was.
    - `path`: the reference, a `.png` file.
    - `tolerance`: largest difference of a channel at which two pixels count as equal; by default
      one level of an 8-bit image, 1/255, since another device may round a tie the other way.
    - `update`: whether to write the image as the new reference, instead of comparing. The folder is
      created if needed.

    Channels are compared as `softras2d.compare` does. If the image differs, it is saved as
    `failures/NAME.png` beside the reference, and the difference picture as
    `failures/NAME-difference.png`; `AssertionError` reports the measures and these paths. If there
    is no reference, or if it has another size, `AssertionError` has a message of one line; an image
    of another size is saved too. Raises `ValueError`, with a message of one line, if `image` is not
    an image or contains NaN or infinity, if `path` has another suffix than `.png` or is damaged,
    and if `tolerance` is negative or not finite.
    """
    __tracebackhide__ = True
    path = Path(path)
    if path.suffix.lower() != ".png":
        raise ValueError(f"{path}: a reference must be a .png file.")
    tolerance = checked_tolerance(tolerance)
    pixels = round_to_levels(as_pixels("`image`", np.asarray(image)))
    if update:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_image(path, pixels)
        return
    if not path.is_file():
        raise AssertionError(
            f"{path}: there is no such reference; `pytest --update-references` writes it "
            "(or `update=True`)."
        )
    expected = read_image(path)
    if pixels.shape[:2] != expected.shape[:2]:
        actual_path = _save(path, "", pixels)
        height, width = pixels.shape[:2]
        raise AssertionError(
            f"the image has height {height} and width {width}, but {path} has height "
            f"{expected.shape[0]} and width {expected.shape[1]}; the image: {actual_path}"
        )
    # Most assertions hold, so the costly measures are computed only after a failure.
    if not exceeds(pixel_difference(*comparable_pixels(pixels, expected)), tolerance).any():
        return
    comparison = compare(pixels, expected, tolerance=tolerance)
    raise AssertionError(
        f"the image differs from its reference.\n{comparison}\n"
        f"reference   {path}\n"
        f"image       {_save(path, '', pixels)}\n"
        f"difference  {_save(path, '-difference', comparison.picture)}"
    )


def _save(
    reference: Path, ending: str, pixels: Float32[np.ndarray, "height width channels"]
) -> Path:
    """Save an image of a failed assertion in the folder `FAILURES` beside its reference.

    The name of the file is that of the reference, with `ending` before the suffix. Returns its
    path.
    """
    path = reference.parent / FAILURES / f"{reference.stem}{ending}.png"
    path.parent.mkdir(exist_ok=True)
    write_image(path, pixels)
    return path
