"""Image files with random changes are read, or refused in one line that names the file."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

from softras2d.io.images import decode_image, read_image, write_image

from ..cases.fuzzing import cases, damaged

pytestmark = pytest.mark.slow

_FORMATS = (".png", ".exr", ".jpg", ".tif")

_SIZES = (0, 1, 2, 3, 7, 255, 256, 65535, 2**16, 2**24, 2**31 - 1, 2**31, 2**32 - 1)


def originals(folder: Path) -> list[bytes]:
    """The bytes of small images in every format that the package writes."""
    rng = np.random.default_rng(0)
    files = []
    for suffix in _FORMATS:
        for channels in (1, 3, 4):
            if channels == 4 and suffix == ".jpg":
                continue
            for height, width in ((1, 1), (5, 9), (40, 33)):
                image = rng.random((height, width, channels), np.float32)
                path = folder / f"original{suffix}"
                write_image(path, image)
                files.append(path.read_bytes())
    return files


def with_other_size(data: bytes, rng: np.random.Generator) -> bytes:
    """The same pixels under a header that claims another size."""
    size = int(rng.choice(_SIZES))
    changed = bytearray(data)
    if data.startswith(b"\x89PNG"):
        struct.pack_into(">I", changed, int(rng.choice([16, 20])), size)
        # The checksum is updated too, so that the header is accepted.
        struct.pack_into(">I", changed, 29, zlib.crc32(bytes(changed[12:29])))
        return bytes(changed)
    if data.startswith(b"\xff\xd8"):
        at = data.find(b"\xff\xc0")
        struct.pack_into(">H", changed, at + int(rng.choice([5, 7])), size & 0xFFFF)
        return bytes(changed)
    if data.startswith(b"\x76\x2f\x31\x01"):
        window = rng.choice([b"dataWindow\0box2i\0", b"displayWindow\0box2i\0"])
        at = data.find(window) + len(window) + 4 + 4 * int(rng.integers(4))
        struct.pack_into("<i", changed, at, size - 2**32 if size >= 2**31 else size)
        return bytes(changed)
    # TIFF: width and height are entries 256 and 257 of the directory.
    (at,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, at)
    for entry in range(count):
        (tag,) = struct.unpack_from("<H", data, at + 2 + 12 * entry)
        if tag == 256 + rng.integers(2):
            struct.pack_into("<HII", changed, at + 4 + 12 * entry, 4, 1, size)
    return bytes(changed)


def test_changed_pictures_are_read_or_refused_in_one_line(tmp_path: Path):
    files = originals(tmp_path)
    path = tmp_path / "picture"
    outcomes = {"read": 0, "refused": 0}
    for number, rng in cases():
        data = files[rng.integers(len(files))]
        if rng.random() < 0.3:
            data = with_other_size(data, rng)
        if rng.random() < 0.9:
            # Half of the changes are within the first 400 bytes, where headers are.
            end = len(data) if rng.random() < 0.5 else min(len(data), 400)
            data = damaged(data[:end], rng) + data[end:]
        path.write_bytes(data)
        linear = bool(rng.integers(2))
        try:
            if rng.random() < 0.8:
                image = read_image(path, linear=linear)
            else:
                image = decode_image(data, "embedded image", linear=linear)
            outcomes["read"] += 1
            assert image.dtype == np.float32 and image.ndim == 3, f"case {number}"
            assert image.shape[2] in (3, 4) and np.isfinite(image).all(), f"case {number}"
        except ValueError as error:
            message = str(error)
            assert message.startswith((f"{path}: ", "embedded image: ")), f"case {number}: {error}"
            assert message.isprintable(), f"case {number}: {message!r}"
            assert message.count("softras2d-") == 0, f"case {number}: {message!r}"
            outcomes["refused"] += 1
        except AssertionError:
            raise
        except Exception as error:
            raise AssertionError(f"case {number}: {error!r}") from error
    print(outcomes)
    assert outcomes["refused"]
