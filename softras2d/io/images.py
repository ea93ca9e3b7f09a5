"""Reads and writes image files, through OpenImageIO.

In memory an image is `[height, width, channels]`, float32, with straight alpha. Its values are
sRGB, or linear light with `linear=True`. What the numbers in a file mean depends on its format:

- integer pixels (PNG, JPEG, 8- and 16-bit TIFF) are sRGB, and float pixels (EXR, float TIFF, HDR)
  are linear light;
- alpha is straight, except that EXR colours are premultiplied, and those of a TIFF unless it
  declares straight alpha.

Reading therefore decodes integer pixels to linear light if `linear=True`, and encodes float pixels
as sRGB if not; writing does the opposite. Writing an RGB or RGBA image of values in 0..1 and
reading it with the same `linear` gives the same image, up to the precision of the format, except
that an EXR loses the colour of pixels whose alpha is 0. In an EXR of an image without alpha,
written and read with `linear=True`, every float32 is bitwise equal.
"""

import os
import tempfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
from jaxtyping import Float32

from ..color import linear_to_srgb, premultiply, srgb_to_linear, unpremultiply
from .budget import BudgetError
from .drafts import atomic_file
from .image_errors import reason_text, unreadable_message
from .image_outputs import check_free_space, close_output, image_spec, open_output
from .outputs import WRITABLE, check_writable_path
from .pixel_values import as_pixels, check_finite, on_colors, to_bytes

MAX_IMAGE_BYTES = 2**30
"""Maximum size of an image as float32, in bytes: 89 million RGB or 67 million RGBA pixels.

All channels of the file count, and at least three. The header of a tiny file can claim any size, so
larger images are refused before they are decoded.
"""

_INTEGERS = {"uint8": (oiio.UINT8, 255), "uint16": (oiio.UINT16, 65535)}
"""How pixels of 8- and 16-bit integers are read, by the name of their format in OpenImageIO.

Each entry has the type in which OpenImageIO is to read the pixels, and the integer that means 1.0.
Pixels of other formats are read as floats.
"""


def read_image(
    path: str | os.PathLike[str], *, linear: bool = False
) -> Float32[np.ndarray, "height width channels"]:
    """Read an image file as RGB, or as RGBA with straight alpha; grey is repeated to RGB.

    Integers become k/255 (8 bits) or k/65535 (16 bits), correctly rounded. Values are linear light
    if `linear=True`, else sRGB; integer pixels are taken to be sRGB, and float pixels, which may
    lie outside 0..1, linear light. The EXIF orientation is applied. If the file has several images,
    the first is read. Raises `ValueError`, one line, if the file is missing, damaged or not an
    image, for NaN and infinity, and for an image of more than `MAX_IMAGE_BYTES`, 1 GiB.
    """
    return _load(Path(path), str(path), linear)


def image_size(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Read the (height, width) of an image file in pixels, from its header alone.

    The EXIF orientation is applied, as in `read_image`. Raises `ValueError`, one line, if the file
    is missing, not an image, or larger than `MAX_IMAGE_BYTES`.
    """
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"{path}: no such file.")
    source = oiio.ImageInput.open(str(path))
    if source is None:
        raise ValueError(unreadable_message(str(path), path))
    try:
        spec = source.spec()
    finally:
        source.close()
    _check_size(str(path), spec)
    swaps_axes = spec.get_int_attribute("Orientation", 1) in (5, 6, 7, 8)
    return (spec.width, spec.height) if swaps_axes else (spec.height, spec.width)


def read_charged(
    source: Path | bytes, name: str, charge: Callable[[int], None]
) -> Float32[np.ndarray, "height width channels"]:
    """Read an image in sRGB like `read_image`, but call `charge` before its pixels are decoded.

    - `source`: path of a file, or the bytes of one.
    - `name`: what errors call the image.
    - `charge`: called with the number of pixels that the header claims. It may raise an error to
      refuse the image.
    """
    if isinstance(source, bytes):
        with _as_file(source) as path:
            return _load(path, name, False, charge)
    return _load(source, name, False, charge)


def decode_image(
    data: bytes, name: str, *, linear: bool = False
) -> Float32[np.ndarray, "height width channels"]:
    """Read an image like `read_image`, from the bytes of a file; errors call it `name`."""
    with _as_file(data) as path:
        return _load(path, name, linear)


@contextmanager
def _as_file(data: bytes) -> Iterator[Path]:
    """Yield the path of a temporary file with the bytes `data`, which is removed afterwards."""
    # OpenImageIO reads only files from Python. It detects the format from the content.
    with tempfile.TemporaryDirectory(prefix="softras2d-") as folder:
        path = Path(folder) / "image"
        path.write_bytes(data)
        yield path


def write_image(
    path: str | os.PathLike[str], image: Any, *, linear: bool = False, truncate: bool = False
) -> None:
    """Write floats `[height, width, 1, 3 or 4]` as PNG, JPEG or TIFF (8 bits) or EXR (float32).

    The suffix of `path` chooses the format. Alpha, the fourth channel, is straight. In 8-bit files,
    values are clipped to 0..1 and rounded to the nearest k/255. `truncate=True` takes floor(255 x)
    in float32 instead, as the rasterizer course of dialect `"course"` (`read_svg`) does. This
    preserves every k/255 too. `linear=True` means that the values are linear light instead of sRGB.
    An EXR stores linear light, premultiplied and not clipped; the other formats store sRGB. The
    file is written completely or not at all. Raises `ValueError`, one line, for NaN, infinity and
    values that become infinite in an EXR, another shape or dtype, alpha in a JPEG, an unknown
    suffix, or a file that cannot be written, such as one in a folder that does not exist.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in WRITABLE:
        raise ValueError(f"{path}: the suffix must be one of {', '.join(WRITABLE)}.")
    pixels = _checked_pixels(path, np.asarray(image))
    pixels = stored_pixels(path, pixels, linear=linear, truncate=truncate)
    with atomic_file(path) as draft:
        _save(draft, path, pixels)


def stored_pixels(path: Path, pixels: np.ndarray, *, linear: bool, truncate: bool) -> np.ndarray:
    """Convert float32 pixels to the numbers that a file with the suffix of `path` stores.

    - `pixels`: finite values with straight alpha: linear light if `linear`, else sRGB.
    - `truncate`: whether bytes are rounded down instead of to the nearest.

    Returns sRGB bytes with straight alpha, clipped to 0..255; for an EXR, premultiplied linear
    light in float32. Raises `ValueError` that names `path` for an EXR whose values would not be
    finite in float32.
    """
    if path.suffix.lower() != ".exr":
        pixels = on_colors(linear_to_srgb, pixels) if linear else pixels
        return to_bytes(pixels, truncate=truncate)
    pixels = pixels if linear else on_colors(srgb_to_linear, pixels)
    # Finite values in sRGB may overflow float32 in linear light.
    check_finite(str(path), pixels)
    with np.errstate(over="ignore"):
        pixels = premultiply(pixels)
    check_finite(str(path), pixels)
    return pixels


def _load(
    path: Path, name: str, linear: bool, charge: Callable[[int], None] | None = None
) -> Float32[np.ndarray, "height width channels"]:
    """Read an image file as RGB or RGBA with straight alpha.

    - `name`: what errors call the file.
    - `linear`: whether values become linear light, rather than sRGB.
    - `charge`: as in `read_charged`; None for no call.

    Raises `ValueError` as `read_image` does.
    """
    if path.is_dir():
        raise ValueError(f"{name}: a folder, not an image.")
    if not path.exists():
        raise ValueError(f"{name}: no such file.")
    try:
        pixels, spec = _read_channels(path, name, charge)
        channel_names = [channel.upper() for channel in spec.channelnames]
    except UnicodeDecodeError:
        # OpenImageIO decodes names in a file, and messages that contain them, as UTF-8.
        raise ValueError(f"{name}: the image is damaged: a name in it is not UTF-8.") from None
    pixels = _select_rgba(pixels, channel_names)
    is_float = np.dtype(str(spec.format).replace("half", "float16")).kind == "f"
    is_premultiplied = _is_premultiplied(path, spec)
    if is_premultiplied:
        with np.errstate(over="ignore", invalid="ignore"):
            pixels = unpremultiply(pixels)
    if is_float or is_premultiplied:
        check_finite(name, pixels)
    if is_float and not linear:
        pixels = on_colors(linear_to_srgb, pixels)
    if linear and not is_float:
        pixels = on_colors(srgb_to_linear, pixels)
    return np.ascontiguousarray(_upright(pixels, spec.get_int_attribute("Orientation", 1)))


def _read_channels(
    path: Path, name: str, charge: Callable[[int], None] | None
) -> tuple[Float32[np.ndarray, "height width channels"], Any]:
    """Read all channels of a file as float32, and its header, OpenImageIO's `ImageSpec`.

    Unsigned integers become 0..1; there is no other conversion. Errors and `charge` are as in
    `_load`.
    """
    _check_png_chunks(path, name)
    hint = oiio.ImageSpec()
    # Without this hint, PNG colours are premultiplied and rounded to bytes.
    hint.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(str(path), hint)
    if source is None:
        raise ValueError(unreadable_message(name, path))
    try:
        spec = source.spec()
        _check_size(name, spec)
        if charge is not None:
            charge(spec.width * spec.height)
        stored_type, maximum = _INTEGERS.get(str(spec.format), (oiio.FLOAT, 1))
        pixels = source.read_image(0, 0, 0, spec.nchannels, stored_type)
        # A truncated JPEG is filled up with grey; the error is the only sign of it.
        error = source.geterror()
    finally:
        source.close()
    if pixels is None or error:
        raise ValueError(f"{name}: the image is damaged or cut short{reason_text(error, path)}.")
    shape = (spec.height, spec.width, spec.nchannels)
    # Division rounds correctly; OpenImageIO multiplies by a rounded 1/255. A signalling NaN makes
    # numpy warn here, and is reported by `check_finite` later.
    with np.errstate(invalid="ignore"):
        floats = np.asarray(pixels).reshape(shape).astype(np.float32)
        floats /= np.float32(maximum)
    return floats, spec


def _check_size(name: str, spec: Any) -> None:
    """Raise `BudgetError`, which names the image `name`, for a header that claims too many pixels.

    `spec` is the header, an `ImageSpec`. The limit is `MAX_IMAGE_BYTES` as float32.
    """
    size = spec.width * spec.height * max(spec.depth, 1) * max(spec.nchannels, 3) * 4
    if size > MAX_IMAGE_BYTES:
        raise BudgetError(
            f"{name}: {spec.width} x {spec.height} pixels are too many: {size / 2**30:.1f} GiB "
            f"as float32; at most {MAX_IMAGE_BYTES >> 30} GiB is read."
        )


def _check_png_chunks(path: Path, name: str) -> None:
    """Raise `ValueError` for a PNG that has a damaged chunk or is cut short.

    For such a file, libpng would print to stderr. Files of other formats pass. Errors call the file
    `name`.
    """
    with path.open("rb") as file:
        if file.read(8) != b"\x89PNG\r\n\x1a\n":
            return
        data = file.read()
    start, kind = 0, b""
    while kind != b"IEND":
        # A chunk has a length, a kind, data, and a checksum of kind and data.
        length, kind = int.from_bytes(data[start : start + 4], "big"), data[start + 4 : start + 8]
        end = start + 8 + length
        checksum = zlib.crc32(memoryview(data)[start + 4 : end]).to_bytes(4, "big")
        if len(kind) < 4 or not kind.isalpha() or data[end : end + 4] != checksum:
            raise ValueError(f"{name}: the image is damaged or cut short.")
        start = end + 4


def _select_rgba(pixels: np.ndarray, names: list[str]) -> np.ndarray:
    """Select RGB, and A if there is one, from the channels of a file.

    `names` has the name of each channel, in upper case. Without channels R, G and B, the first
    three channels other than A are colours. If there are fewer than three, the first is repeated.
    The only channel of a file is a colour, whatever its name.
    """
    not_alpha = [index for index, name in enumerate(names) if name != "A"] or [0]
    if {"R", "G", "B"} <= set(names):
        chosen = [names.index(name) for name in "RGB"]
    else:
        chosen = not_alpha[:3] if len(not_alpha) >= 3 else not_alpha[:1] * 3
    if "A" in names and len(names) > 1:
        chosen.append(names.index("A"))
    # Choosing all channels in their order would copy the image.
    return pixels if chosen == list(range(pixels.shape[-1])) else pixels[..., chosen]


def _is_premultiplied(path: Path, spec: Any) -> bool:
    """Whether a file's colours are premultiplied by alpha.

    Colours are premultiplied in every EXR, in a TIFF unless it declares straight alpha, and in no
    other format. The format is recognised by the first bytes of the file. `spec` is the header of
    the file, OpenImageIO's `ImageSpec`.
    """
    with path.open("rb") as file:
        magic = file.read(4)
    if magic == b"\x76\x2f\x31\x01":
        return True
    is_tiff = magic in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
    return is_tiff and not spec.get_int_attribute("oiio:UnassociatedAlpha", 0)


def _upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Rotate and mirror an image of EXIF orientation 1 to 8, so that it is upright.

    **Source:** EXIF 2.32, tag 0x0112. From 5 on, the stored rows are the columns of the image.
    """
    if orientation in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return pixels


def _checked_pixels(path: Path, image: np.ndarray) -> np.ndarray:
    """Check that an image can be written to `path`; returns it as float32.

    Raises `ValueError` for what is not an image of finite floats, for alpha in a JPEG, for a folder
    that does not exist, and for a `path` that is a folder.
    """
    pixels = as_pixels(str(path), image)
    if image.shape[-1] == 4 and path.suffix.lower() in (".jpg", ".jpeg"):
        raise ValueError(
            f"{path}: JPEG stores no alpha, which the image has; write PNG, TIFF or EXR."
        )
    check_writable_path(path)
    return pixels


def _save(draft: Path, path: Path, pixels: np.ndarray) -> None:
    """Write pixels, as `stored_pixels` returns them, to `draft` in the format of its suffix.

    `draft` is the file beside `path` that will replace it (`drafts.atomic_file`). Raises
    `ValueError`, whose message names `path`, not `draft`.
    """
    height, width, channels = pixels.shape
    check_free_space(draft, path, pixels.nbytes)
    spec = image_spec(draft, (height, width, channels), pixels.dtype)
    target = open_output(draft, path, spec)
    is_written = target.write_image(np.ascontiguousarray(pixels))
    close_output(target, draft, path, bool(is_written))
