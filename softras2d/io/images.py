"""Image files in and out, through OpenImageIO.

In memory an image is `[height, width, channels]`, float32, straight alpha, and holds the values
that the file shows: sRGB, or linear light where the caller said `linear=True`. Files have the
meaning of their format:

- integer pixels (PNG, JPEG, 8- and 16-bit TIFF) are sRGB with straight alpha; TIFF may say that its
  alpha is premultiplied;
- float pixels (EXR, float TIFF, HDR) are linear light, and EXR colour is premultiplied.

So `linear=True` decodes the first kind, its absence encodes the second, and what was written is
read back under the same `linear`. An EXR of an image without alpha, written and read with
`linear=True`, keeps every float32 bit.
"""

import os
import shutil
import tempfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
from jaxtyping import Float32, UInt8

from .drafts import atomic_file

WRITABLE = (".png", ".exr", ".jpg", ".jpeg", ".tif", ".tiff")
"""Suffixes that `write_image` knows."""

MAX_IMAGE_BYTES = 2**30
"""Memory of a picture as float32, with all the channels of its file and at least three. A few bytes
can claim any size, so a larger picture is refused by its header, before it is decoded. As RGB that
is 89 million pixels, as RGBA 67 million (8192 x 8192)."""

_STEPS = {"uint8": (oiio.UINT8, 255), "uint16": (oiio.UINT16, 65535)}


def read_image(
    path: str | os.PathLike[str], *, linear: bool = False
) -> Float32[np.ndarray, "height width channels"]:
    """The image in a file: RGB, or RGBA with straight alpha; grey is repeated to RGB.

    Integers become k/255 (k/65535) exactly rounded. `linear=True` gives linear light, else sRGB.
    The orientation that a camera noted is applied. Of several images in one file the first is read.
    Raises `ValueError`, one line, for what is not a whole image file, for NaN and infinity, and for
    a picture that takes more than `MAX_IMAGE_BYTES`, 1 GiB.
    """
    return _load(Path(path), str(path), linear)


def read_charged(
    source: Path | bytes, name: str, charge: Callable[[int], None]
) -> Float32[np.ndarray, "height width channels"]:
    """As `read_image` or `decode_image`, once `charge` has accepted the number of pixels.

    `charge` hears the number that the header claims before anything is decoded, and may raise.
    """
    if isinstance(source, bytes):
        with _as_file(source) as path:
            return _load(path, name, False, charge)
    return _load(source, name, False, charge)


def decode_image(
    data: bytes, name: str, *, linear: bool = False
) -> Float32[np.ndarray, "height width channels"]:
    """As `read_image`, from the bytes of a file of any format; errors call it `name`."""
    with _as_file(data) as path:
        return _load(path, name, linear)


@contextmanager
def _as_file(data: bytes) -> Iterator[Path]:
    """A temporary file of these bytes."""
    # OpenImageIO's Python face reads files only. It knows the format by the content.
    with tempfile.TemporaryDirectory(prefix="softras2d-") as folder:
        path = Path(folder) / "image"
        path.write_bytes(data)
        yield path


def write_image(
    path: str | os.PathLike[str], image: Any, *, linear: bool = False, truncate: bool = False
) -> None:
    """Write floats `[height, width, 1, 3 or 4]` as PNG, JPEG or TIFF (8 bits) or EXR (float32).

    The suffix decides. 8-bit files hold values clipped to 0..1 and rounded to the nearest k/255;
    `truncate=True` takes floor(255 x) in float32 instead, the bytes of the course, which k/255
    survives for every k. `linear=True` says that the image is linear light; see the top of this
    file. The file appears whole or not at all. Raises `ValueError`, one line, for NaN and infinity,
    another shape or dtype, an unknown suffix, or a folder that is not there.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in WRITABLE:
        raise ValueError(f"{path}: the suffix must be one of {', '.join(WRITABLE)}.")
    pixels = _writable(path, np.asarray(image))
    if suffix == ".exr":
        pixels = pixels if linear else _on_colors(srgb_to_linear, pixels)
        # What is finite in sRGB may be too bright for float32 in linear light.
        _check_finite(str(path), pixels)
        with np.errstate(over="ignore"):
            pixels = _premultiply(pixels)
        _check_finite(str(path), pixels)
    else:
        pixels = _on_colors(linear_to_srgb, pixels) if linear else pixels
        pixels = to_bytes(pixels, truncate=truncate)
    with atomic_file(path) as draft:
        _save(draft, path, pixels)


def to_bytes(
    pixels: Float32[np.ndarray, "*shape"], *, truncate: bool = False
) -> UInt8[np.ndarray, "*shape"]:
    """Clipped to 0..1 and rounded to the nearest k/255, or down if `truncate`."""
    scaled = np.clip(pixels, 0.0, 1.0) * np.float32(255.0)
    return np.floor(scaled if truncate else scaled + np.float32(0.5)).astype(np.uint8)


def srgb_to_linear(values: np.ndarray) -> np.ndarray:
    """sRGB to linear light, odd about zero; 1 stays 1.

    **Source:** IEC 61966-2-1.
    """
    size = np.abs(values)
    # What is too bright for the type becomes infinite; the branch that is not taken may overflow.
    with np.errstate(over="ignore"):
        light = np.where(size <= 0.04045, size / 12.92, ((size + 0.055) / 1.055) ** 2.4)
    return np.copysign(light, values).astype(values.dtype)


def linear_to_srgb(values: np.ndarray) -> np.ndarray:
    """Linear light to sRGB: the inverse of `srgb_to_linear`."""
    size = np.abs(values)
    with np.errstate(over="ignore"):
        code = np.where(size <= 0.04045 / 12.92, size * 12.92, 1.055 * size ** (1 / 2.4) - 0.055)
    return np.copysign(code, values).astype(values.dtype)


def _load(
    path: Path, name: str, linear: bool, charge: Callable[[int], None] | None = None
) -> np.ndarray:
    if path.is_dir():
        raise ValueError(f"{name}: a folder, not an image.")
    if not path.exists():
        raise ValueError(f"{name}: no such file.")
    try:
        pixels, spec = _pixels(path, name, charge)
        channels = [channel.upper() for channel in spec.channelnames]
    except UnicodeDecodeError:
        # Of OpenImageIO, which takes the names in a file, and what it says of them, for UTF-8.
        raise ValueError(f"{name}: the image is damaged: a name in it is not UTF-8.") from None
    pixels = _channels(pixels, channels)
    floats = np.dtype(str(spec.format).replace("half", "float16")).kind == "f"
    if _is_premultiplied(path, spec):
        with np.errstate(over="ignore", invalid="ignore"):
            pixels = _unpremultiply(pixels)
    _check_finite(name, pixels)
    if floats and not linear:
        pixels = _on_colors(linear_to_srgb, pixels)
    if linear and not floats:
        pixels = _on_colors(srgb_to_linear, pixels)
    return np.ascontiguousarray(_upright(pixels, spec.get_int_attribute("Orientation", 1)))


def _pixels(path: Path, name: str, charge: Callable[[int], None] | None) -> tuple[np.ndarray, Any]:
    """The raw channels as float32, and the file's `ImageSpec`."""
    _refuse_cut_png(path, name)
    hint = oiio.ImageSpec()
    # Otherwise PNG colours come multiplied by alpha, and rounded to bytes after that.
    hint.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(str(path), hint)
    if source is None:
        raise ValueError(f"{name}: not an image that can be read{_why(oiio.geterror(), path)}.")
    try:
        spec = source.spec()
        _check_size(name, spec)
        if charge is not None:
            charge(spec.width * spec.height)
        kind, step = _STEPS.get(str(spec.format), (oiio.FLOAT, 1))
        pixels = source.read_image(0, 0, 0, spec.nchannels, kind)
        # A cut JPEG comes back filled with grey: the error is the only sign.
        error = source.geterror()
    finally:
        source.close()
    if pixels is None or error:
        raise ValueError(f"{name}: the image is damaged or cut short{_why(error, path)}.")
    shape = (spec.height, spec.width, spec.nchannels)
    # Dividing rounds correctly; OpenImageIO multiplies by a rounded 1/255.
    # A signalling NaN warns, and is refused later on by its place.
    with np.errstate(invalid="ignore"):
        floats = np.array(pixels, np.float32).reshape(shape)
        floats /= np.float32(step)
    return floats, spec


def _check_size(name: str, spec: Any) -> None:
    """Raise for a header that claims more than `MAX_IMAGE_BYTES`."""
    size = spec.width * spec.height * max(spec.depth, 1) * max(spec.nchannels, 3) * 4
    if size > MAX_IMAGE_BYTES:
        raise ValueError(
            f"{name}: {spec.width} x {spec.height} pixels are too many: {size / 2**30:.1f} GiB "
            f"as float32, of at most {MAX_IMAGE_BYTES >> 30}."
        )


def _refuse_cut_png(path: Path, name: str) -> None:
    """Raise for a PNG whose chunks are not whole, about which libpng itself prints to stderr."""
    with path.open("rb") as file:
        if file.read(8) != b"\x89PNG\r\n\x1a\n":
            return
        data = file.read()
    at, kind = 0, b""
    while kind != b"IEND":
        # Length, kind, data, and a checksum of the latter two.
        length, kind = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        end = at + 8 + length
        checksum = zlib.crc32(memoryview(data)[at + 4 : end]).to_bytes(4, "big")
        if len(kind) < 4 or not kind.isalpha() or data[end : end + 4] != checksum:
            raise ValueError(f"{name}: the image is damaged or cut short.")
        at = end + 4


def _channels(pixels: np.ndarray, names: list[str]) -> np.ndarray:
    """RGB or RGBA out of the channels that a file has."""
    plain = [index for index, name in enumerate(names) if name != "A"] or [0]
    if {"R", "G", "B"} <= set(names):
        chosen = [names.index(name) for name in "RGB"]
    else:
        chosen = plain[:3] if len(plain) >= 3 else plain[:1] * 3
    if "A" in names and len(names) > 1:
        chosen.append(names.index("A"))
    return pixels[..., chosen]


def _is_premultiplied(path: Path, spec: Any) -> bool:
    """EXR is so by convention, TIFF says so; the formats left have straight alpha."""
    with path.open("rb") as file:
        magic = file.read(4)
    if magic == b"\x76\x2f\x31\x01":
        return True
    is_tiff = magic in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
    return is_tiff and not spec.get_int_attribute("oiio:UnassociatedAlpha", 0)


def _on_colors(convert: Any, pixels: np.ndarray) -> np.ndarray:
    """`convert` applied to all channels but alpha."""
    colors = 3 if pixels.shape[-1] == 4 else pixels.shape[-1]
    return np.concatenate([convert(pixels[..., :colors]), pixels[..., colors:]], axis=-1)


def _premultiply(pixels: np.ndarray) -> np.ndarray:
    if pixels.shape[-1] != 4:
        return pixels
    return np.concatenate([pixels[..., :3] * pixels[..., 3:], pixels[..., 3:]], axis=-1)


def _unpremultiply(pixels: np.ndarray) -> np.ndarray:
    """Straight colours; zero where alpha is zero."""
    if pixels.shape[-1] != 4:
        return pixels
    alpha = pixels[..., 3:]
    colors = np.where(alpha > 0, pixels[..., :3] / np.where(alpha > 0, alpha, 1.0), 0.0)
    return np.concatenate([colors.astype(np.float32), alpha], axis=-1)


def _upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Rows from the top, columns from the left, for EXIF orientations 1 to 8.

    **Source:** EXIF 2.32, tag 0x0112. From 5 on the stored rows are the columns of the picture.
    """
    if orientation in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return pixels


def _writable(path: Path, image: np.ndarray) -> np.ndarray:
    """`image` as float32, after every check that needs no disk but the folder's."""
    pixels = as_pixels(str(path), image)
    if image.shape[-1] == 4 and path.suffix.lower() in (".jpg", ".jpeg"):
        raise ValueError(f"{path}: JPEG holds no alpha; write PNG, TIFF or EXR.")
    check_writable_path(path)
    return pixels


def as_pixels(where: str, image: np.ndarray) -> Float32[np.ndarray, "height width channels"]:
    """`image` as float32. Raises `ValueError`, which begins with `where`, if it is no image."""
    if image.ndim != 3 or image.shape[-1] not in (1, 3, 4) or 0 in image.shape:
        raise ValueError(f"{where}: an image is [height, width, 1, 3 or 4]; got {image.shape}.")
    if image.dtype not in (np.float16, np.float32, np.float64):
        raise ValueError(f"{where}: an image holds floats, 0..1; got {image.dtype}.")
    with np.errstate(over="ignore"):
        pixels = image.astype(np.float32)
    _check_finite(where, pixels)
    return pixels


def _check_finite(where: str, pixels: np.ndarray) -> None:
    """Raise `ValueError`, which begins with `where`, for the first value that is not finite."""
    finite = np.isfinite(pixels)
    if not finite.all():
        row, column, channel = (int(i) for i in np.argwhere(~finite)[0])
        value = pixels[row, column, channel]
        raise ValueError(f"{where}: row {row}, column {column}, channel {channel} is {value}.")


def check_writable_path(path: Path) -> None:
    """Raise `ValueError` if no file can be at `path`."""
    if path.is_dir():
        raise ValueError(f"{path}: a folder, not a file to write.")
    if not path.parent.is_dir():
        raise ValueError(f"{path}: there is no folder {path.parent}.")


def _save(draft: Path, path: Path, pixels: np.ndarray) -> None:
    height, width, channels = pixels.shape
    # The JPEG library ends the whole process when the disk is full.
    if shutil.disk_usage(draft.parent).free < pixels.nbytes + 2**16:
        raise ValueError(f"{path}: no room, {pixels.nbytes / 1e6:.1f} MB may be needed.")
    spec = oiio.ImageSpec(width, height, channels, str(pixels.dtype).replace("float32", "float"))
    if draft.suffix != ".exr":
        # Without it OpenImageIO takes the colours for premultiplied and divides them.
        spec.attribute("oiio:UnassociatedAlpha", 1)
    if draft.suffix in (".jpg", ".jpeg"):
        spec.attribute("compression", "jpeg:95")
        spec.attribute("jpeg:subsampling", "4:4:4")
    target = oiio.ImageOutput.create(str(draft))
    if target is None:
        raise ValueError(f"{path}: cannot be written{_why(oiio.geterror(), draft)}.")
    done = target.open(str(draft), spec) and target.write_image(np.ascontiguousarray(pixels))
    # Closing writes what is buffered, so it may be what finds the disk full.
    if not (target.close() and done) or not _is_whole(draft):
        raise ValueError(f"{path}: cannot be written{_why(target.geterror(), draft)}.")


def _is_whole(draft: Path) -> bool:
    """Whether a PNG ends as one does: OpenImageIO does not tell when the disk was full."""
    if draft.suffix != ".png":
        return True
    with draft.open("rb") as file:
        file.seek(max(0, draft.stat().st_size - 8))
        return file.read() == b"IEND\xae\x42\x60\x82"


def _why(message: str, path: Path) -> str:
    """OpenImageIO's first line, without the name of a file that the user never named."""
    first = message.strip().splitlines()[0] if message.strip() else ""
    for quoted in (f' ("{path}")', f" ({path})"):
        first = first.replace(quoted, "")
    for named in (f'"{path}"', str(path), path.name):
        first = first.replace(named, "it")
    first = "".join(c if c.isprintable() else "?" for c in first).rstrip(".")
    return f" ({first})" if first else ""
