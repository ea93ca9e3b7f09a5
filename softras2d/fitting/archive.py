"""Reads the arrays of an `.npz` that nobody vouches for, in memory that is known beforehand.

NumPy's own reader allocates what a header claims, and a zip of 3 MB may hold 3 GB of zeros. Here
the directory and every header are held against each other before anything is unpacked.
"""

import math
import re
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

MAX_BYTES = 2**30
"""Unpacked, of all arrays together; larger files are refused, and not written."""

_MAX_ENTRIES = 1000

_HEADER = re.compile(
    rb"\{'descr': '([^']{2,20})', 'fortran_order': (True|False), "
    rb"'shape': \(((?:\d{1,10}(?:, \d{1,10}){0,7},?)?)\), \} *\n"
)
"""As NumPy writes it, for arrays of plain types."""

_MAGIC = b"\x93NUMPY\x01\x00"


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays in a file, by name; all are numbers or truth values.

    Raises `ValueError`, one line with the file and, where there is one, the entry.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            _check_directory(entries)
            return {entry.filename.removesuffix(".npy"): _read(archive, entry) for entry in entries}
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}.") from None
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        told = " ".join(str(error).split()) or "it is cut short"
        raise ValueError(f"{path}: not a whole .npz file: {_printable(told)}.") from None
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    except (struct.error, LookupError, NotImplementedError, RuntimeError) as error:
        # What else a broken directory leads `zipfile` to: structs, names, methods of compression.
        told = type(error).__name__
        raise ValueError(f"{path}: not a whole .npz file ({told}).") from None


def _check_directory(entries: list[zipfile.ZipInfo]) -> None:
    if len(entries) > _MAX_ENTRIES:
        raise ValueError(f"holds {len(entries)} entries; {_MAX_ENTRIES} at most are read.")
    total = sum(entry.file_size for entry in entries)
    if total > MAX_BYTES:
        raise ValueError(f"unpacks to {total} bytes; {MAX_BYTES} at most are read.")
    names = [entry.filename for entry in entries]
    for name in names:
        if not name.endswith(".npy") or names.count(name) > 1:
            raise ValueError(f"entry {_printable(name)!r} is not an array, or is there twice.")
    for entry in entries:
        plain = entry.compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
        if not plain or entry.flag_bits & 1:
            name = _printable(entry.filename.removesuffix(".npy"))
            raise ValueError(f"`{name}` must be stored or deflated, without a password.")


def _read(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    """One array. The directory's sizes hold: `zipfile` unpacks no more than they say."""
    name = _printable(entry.filename.removesuffix(".npy"))
    try:
        with archive.open(entry) as file:
            dtype, shape, fortran, offset = _header(name, file)
            wanted = math.prod(shape) * dtype.itemsize
            if offset + wanted != entry.file_size:
                raise ValueError(
                    f"`{name}` must have {wanted} bytes of data, as its header says; it has "
                    f"{entry.file_size - offset}."
                )
            data = file.read(wanted)
            # At the end, where the checksum is looked at.
            if len(data) != wanted or file.read(1):
                raise EOFError(f"`{name}` is cut short")
    except zipfile.BadZipFile:
        raise ValueError(f"`{name}` is damaged: its checksum or its header differs.") from None
    except zlib.error:
        raise ValueError(f"`{name}` is damaged: it cannot be unpacked.") from None
    array = np.frombuffer(data, dtype).copy()
    if dtype.kind == "b" and (array.view(np.uint8) > 1).any():
        raise ValueError(f"`{name}` must hold truth values, 0 or 1.")
    return array.reshape(shape, order="F" if fortran else "C")


def _header(name: str, file: Any) -> tuple[np.dtype, tuple[int, ...], bool, int]:
    """Type, shape, whether columns come first, and how many bytes the header takes.

    `file`: the entry, opened to read bytes.
    """
    start = file.read(len(_MAGIC) + 2)
    length = int.from_bytes(start[len(_MAGIC) :], "little")
    found = _HEADER.fullmatch(file.read(length)) if start.startswith(_MAGIC) else None
    if found is None:
        raise ValueError(f"`{name}` must be an array as NumPy saves it; its header is another.")
    kind = found[1].decode("latin-1")
    try:
        dtype = np.dtype(kind)
    except (TypeError, ValueError):
        dtype = None
    if dtype is None or dtype.kind not in "biuf" or dtype.fields or dtype.subdtype:
        raise ValueError(f"`{name}` must be an array of numbers; got {_printable(kind)!r}.")
    shape = tuple(int(size) for size in found[3].replace(b",", b" ").split())
    return dtype, shape, found[2] == b"True", len(start) + length


def _printable(text: str) -> str:
    return "".join(c if c.isprintable() else "?" for c in text[:80])
