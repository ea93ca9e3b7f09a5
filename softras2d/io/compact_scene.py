"""Reads and writes compact binary files of scenes: rounded positions and colours, compressed.

The file has three parts, with little-endian numbers:

- 8 bytes, the mark `softras2`;
- a header of 24 bytes (`_HEADER`): height and width of the canvas in pixels; number of vertices;
  number of triangles; steps per pixel, in which positions are counted; colours per triangle (1 or
  3); channels of a colour (3 or 4); channels of the background (3 or 4); and 1 if vertex indices
  are implied, because triangle k has the vertices 3k, 3k + 1 and 3k + 2;
- a zlib stream of the positions, in steps; the vertex indices of the triangles, unless they are
  implied; the colours, channel by channel, where each channel is an array `[triangles, colours per
  triangle]`; and the background. Colours are levels of 8 bits: level k means k/255.

Positions and vertex indices are integers of 32 bits. The array of positions is stored with all x
before all y, and the array of indices with all first corners before the second and third corners.
With implied indices, all x are sorted by corner in the same way, and so are all y. Both arrays are
stored as differences, which are small. With implied indices, the position of the first corner of a
triangle is subtracted from the positions of the two other corners. Otherwise, the row before is
subtracted from each row of the array. An integer n is stored as 2n if it is not negative, and as
-2n - 1 if it is (zigzag code). Of each array, the lowest bytes of all integers are stored first,
then all second, third and fourth bytes, because zlib compresses this order better.
"""

import os
import struct
import zlib
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Int, UInt8

from ..numerics.arguments import checked_integer
from ..numerics.device import to_device
from ..scene import Scene, check
from .drafts import atomic_file
from .outputs import check_writable_path

SUFFIX = ".s2d"
"""Suffix of compact scene files."""

_MARK = b"softras2"
_HEADER = struct.Struct("<IIIIHBBBB2x")

_MAX_COUNT = 2**24
"""Maximum number of vertices, and of triangles, of a file."""

_MAX_STEPS = 1024
"""Maximum number of steps per pixel in which positions are counted."""

_MAX_SIDE = 2**32 - 1
"""Maximum height and width of a canvas, in pixels: the header has 32 bits for each."""


class CompactScene(NamedTuple):
    """A scene, and the size of its canvas in pixels, as `read_compact` returns them."""

    scene: Scene
    height: int
    width: int


def write_compact(
    path: str | os.PathLike[str],
    scene: Scene,
    *,
    height: int,
    width: int,
    steps_per_pixel: int = 8,
) -> int:
    """Write a scene as a compact binary file; return the size of the file in bytes.

    - `height`, `width`: size of the canvas, in pixels, 1 to 2^32 - 1, which is stored too.
    - `steps_per_pixel`: 1 to 1024. Positions are rounded to multiples of 1 / `steps_per_pixel`
      pixels.

    Colours are clipped to 0..1 and rounded to 8 bits. The file is written completely or not at all.
    Raises `ValueError`, one line, for a scene with textures, depth or perspective, for a batch of
    scenes, for invalid values, for coordinates of 2^30 steps or more in magnitude, for more than
    2^24 vertices or triangles, for other arguments out of range, and for a file that cannot be
    written, such as one in a folder that does not exist.
    """
    path = Path(path)
    check_writable_path(path)
    check(scene)
    if scene.positions.ndim != 2:
        raise ValueError(
            f"`write_compact` takes one scene, not a batch; got {scene.positions.shape}."
        )
    for name in ("textures", "depth", "inverse_w"):
        if getattr(scene, name) is not None:
            raise ValueError(f"a compact file has no `{name}`, which the scene has.")
    height = checked_integer("height", height, 1, _MAX_SIDE)
    width = checked_integer("width", width, 1, _MAX_SIDE)
    steps_per_pixel = checked_integer("steps_per_pixel", steps_per_pixel, 1, _MAX_STEPS)
    data = _encode(scene, height, width, steps_per_pixel)
    with atomic_file(path) as draft:
        draft.write_bytes(data)
    return len(data)


def read_compact(path: str | os.PathLike[str]) -> CompactScene:
    """Read a file that `write_compact` wrote; returns the scene and the size of its canvas.

    Raises `ValueError`, one line, for a file that is missing, cut short, of another format, damaged
    or of more than 2^24 vertices or triangles. The header has no checksum, so damage to it is
    noticed only if the values become invalid.
    """
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"{path}: no such file.")
    try:
        return _decode(path.read_bytes())
    except (ValueError, struct.error, zlib.error) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"{path}: not a complete compact scene: {reason}.") from None


def _encode(scene: Scene, height: int, width: int, steps_per_pixel: int) -> bytes:
    """Make the bytes of a file, as the top of this module describes them.

    The arguments are as for `write_compact`. Raises `ValueError` for coordinates that are not
    finite, or 2^30 steps or more in magnitude, and for more than `_MAX_COUNT` vertices or
    triangles.
    """
    for name, count in (("vertices", len(scene.positions)), ("triangles", len(scene.triangles))):
        if count > _MAX_COUNT:
            raise ValueError(f"a compact file has at most {_MAX_COUNT:,} {name}; got {count:,}.")
    positions = np.rint(np.asarray(scene.positions, np.float64) * steps_per_pixel)
    if not (np.abs(positions) < 2**30).all():
        raise ValueError("positions must be finite and within 2^30 steps of the canvas.")
    triangles = np.asarray(scene.triangles, np.int64)
    is_implied = np.array_equal(triangles.ravel(), np.arange(len(positions)))
    levels = [_levels(np.asarray(array)) for array in (scene.colors, scene.background)]
    header = _HEADER.pack(
        height, width, len(positions), len(triangles), steps_per_pixel,
        *scene.colors.shape[1:], scene.background.shape[0], is_implied,
    )  # fmt: skip
    steps = positions.astype(np.int64)
    if is_implied:
        soup = steps.reshape(-1, 3, 2)
        soup[:, 1:] -= soup[:, :1]
        blocks = [_encode_integers(soup.transpose(2, 1, 0))]
    else:
        blocks = [
            _encode_integers(_differences(steps).T),
            _encode_integers(_differences(triangles).T),
        ]
    blocks += [np.moveaxis(levels[0], -1, 0).tobytes(), levels[1].tobytes()]
    return _MARK + header + zlib.compress(b"".join(blocks), 9)


def _decode(data: bytes) -> CompactScene:
    """Read the scene and the size of its canvas from the bytes of a file.

    Raises `ValueError`, `struct.error` or `zlib.error` if they are not a complete, valid file.
    """
    if not data.startswith(_MARK):
        raise ValueError("it does not begin with the mark of the format")
    header = _HEADER.unpack_from(data, len(_MARK))
    height, width, vertices, count, steps_per_pixel = header[:5]
    corners, channels, background_channels, is_implied = header[5:]
    is_valid = corners in (1, 3) and channels in (3, 4) and background_channels in (3, 4)
    is_valid = is_valid and min(height, width, steps_per_pixel) > 0
    if not is_valid or max(vertices, count) > _MAX_COUNT or (is_implied and vertices != 3 * count):
        raise ValueError("its header has invalid values")
    index_bytes = 0 if is_implied else 12 * count
    color_bytes = count * corners * channels
    body_bytes = 8 * vertices + index_bytes + color_bytes + background_channels
    unpacker = zlib.decompressobj()
    body = unpacker.decompress(data[len(_MARK) + _HEADER.size :], body_bytes + 1)
    if len(body) != body_bytes or not unpacker.eof:
        raise ValueError(f"{body_bytes} bytes of data were expected; got {len(body)}")
    if unpacker.unused_data:
        raise ValueError(f"{len(unpacker.unused_data)} bytes follow the end of its data")
    steps = _decode_integers(body[: 8 * vertices])
    if is_implied:
        soup = steps.reshape(2, 3, count).transpose(2, 1, 0).copy()
        soup[:, 1:] += soup[:, :1]
        positions, triangles = soup.reshape(-1, 2), np.arange(vertices)
    else:
        positions = np.cumsum(steps.reshape(2, vertices).T, axis=0)
        index_differences = _decode_integers(body[8 * vertices : 8 * vertices + index_bytes])
        triangles = np.cumsum(index_differences.reshape(3, count).T, axis=0)
    levels = np.frombuffer(body, np.uint8)[8 * vertices + index_bytes :]
    colors = np.moveaxis(levels[:color_bytes].reshape(channels, count, corners), 0, -1)
    scene = Scene(
        to_device(positions / steps_per_pixel, np.float32),
        to_device(triangles.reshape(count, 3), np.int32),
        to_device(colors / np.float32(255), np.float32),
        to_device(levels[color_bytes:] / np.float32(255), np.float32),
    )
    check(scene)
    return CompactScene(scene, height, width)


def _levels(colors: np.ndarray) -> UInt8[np.ndarray, "*shape"]:
    """Clip colours to 0..1 and round them to levels of 8 bits: level k, 0 to 255, means k/255."""
    return np.rint(np.clip(colors, 0, 1) * 255).astype(np.uint8)


def _differences(rows: Int[np.ndarray, "rows numbers"]) -> Int[np.ndarray, "rows numbers"]:
    """Difference between each row and the row before it; the first row is unchanged."""
    return np.diff(rows, axis=0, prepend=0)


def _encode_integers(integers: Int[np.ndarray, "..."]) -> bytes:
    """Encode integers of 32 bits: an integer n becomes 2n if it is not negative, else -2n - 1.

    The array is flattened. The lowest byte of each integer comes first, then the second byte of
    each, and so on, four bytes for each integer.
    """
    # Zigzag: small negative numbers become small positive ones, with zeros in their high bytes.
    zigzag = (np.abs(integers) * 2 - (integers < 0)).astype("<u4")
    return zigzag.reshape(-1).view(np.uint8).reshape(-1, 4).T.tobytes()


def _decode_integers(planes: bytes) -> Int[np.ndarray, " integers"]:
    """Decode what `_encode_integers` has encoded, as a one-dimensional array."""
    bytes_of_each = np.frombuffer(planes, np.uint8).reshape(4, -1).T
    zigzag = np.ascontiguousarray(bytes_of_each).view("<u4").ravel().astype(np.int64)
    return np.where(zigzag % 2 == 1, -(zigzag + 1) // 2, zigzag // 2)
