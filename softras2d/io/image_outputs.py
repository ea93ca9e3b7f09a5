"""Opens, closes and checks image files that are written through OpenImageIO.

In all functions, `draft` is the file that is written first, and `path` is the file that it will
replace, which errors name (`drafts.py`).
"""

import shutil
from pathlib import Path
from typing import Any

import OpenImageIO as oiio

from .image_errors import reason_text


def check_free_space(draft: Path, path: Path, size: int) -> None:
    """Raise `ValueError`, which names `path`, unless the disk of `draft` has enough free space.

    `size` is the number of bytes to write; 64 KiB more must be free for headers.
    """
    # The JPEG library terminates the process if the disk is full.
    if shutil.disk_usage(draft.parent).free < size + 2**16:
        raise ValueError(
            f"{path}: not enough space on the disk: {size / 1e6:.1f} MB may be needed."
        )


def image_spec(draft: Path, shape: tuple[int, int, int], dtype: Any) -> Any:
    """Make OpenImageIO's `ImageSpec` for writing an image in the format of the suffix of `draft`.

    `shape` is `(height, width, channels)`; `dtype` is the NumPy dtype of float32 or of an unsigned
    integer. Alpha is declared as premultiplied in an EXR, and as straight in other formats. A JPEG
    has quality 95, without chroma subsampling.
    """
    height, width, channels = shape
    spec = oiio.ImageSpec(width, height, channels, str(dtype).replace("float32", "float"))
    suffix = draft.suffix.lower()
    if suffix != ".exr":
        # Without this, OpenImageIO assumes premultiplied colours and divides them by alpha.
        spec.attribute("oiio:UnassociatedAlpha", 1)
    if suffix in (".jpg", ".jpeg"):
        spec.attribute("compression", "jpeg:95")
        spec.attribute("jpeg:subsampling", "4:4:4")
    return spec


def open_output(draft: Path, path: Path, spec: Any) -> Any:
    """Open `draft` for writing an image; returns OpenImageIO's `ImageOutput`.

    `spec` is a result of `image_spec`. Raises `ValueError`, whose message names `path`, not
    `draft`.
    """
    target = oiio.ImageOutput.create(str(draft))
    if target is None:
        raise ValueError(f"{path}: cannot be written{reason_text(oiio.geterror(), draft)}.")
    if not target.open(str(draft), spec):
        raise ValueError(f"{path}: cannot be written{reason_text(target.geterror(), draft)}.")
    return target


def close_output(target: Any, draft: Path, path: Path, is_written: bool) -> None:
    """Close the result of `open_output`; raise `ValueError` if the file is known to be incomplete.

    `is_written` says whether all writes so far have succeeded. The error calls the file `path`.
    """
    # Closing writes buffered data, so it may fail if the disk is full.
    if not (target.close() and is_written) or not _is_complete(draft):
        raise ValueError(f"{path}: cannot be written{reason_text(target.geterror(), draft)}.")


def _is_complete(draft: Path) -> bool:
    """Whether a PNG ends with its last chunk, `IEND`; True for other formats.

    OpenImageIO does not report a full disk while it writes a PNG.
    """
    if draft.suffix.lower() != ".png":
        return True
    with draft.open("rb") as file:
        file.seek(max(0, draft.stat().st_size - 8))
        return file.read() == b"IEND\xae\x42\x60\x82"
