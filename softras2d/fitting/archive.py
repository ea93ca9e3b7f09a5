"""Read the arrays of an untrusted `.npz` file within a fixed limit of memory.

NumPy's own reader allocates as much as a header claims, and a zip file of 3 MB may unpack to 3 GB
of zeros. Here the sizes in the zip directory are checked first, and each array's header must agree
with the directory before its data is unpacked.
"""

import math
import re
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

MAX_BYTES = 2**30
"""Largest number of bytes of all arrays of a file together, after unpacking.

Larger files are neither read nor written."""

_MAX_ENTRIES = 1000
"""Largest number of arrays in a file; files with more are not read."""

_HEADER_PATTERN = re.compile(
    rb"\{'descr': '([^']{2,20})', 'fortran_order': (True|False), "
    rb"'shape': \(((?:\d{1,10}(?:, \d{1,10}){0,7},?)?)\), \} *\n"
)
"""Regular expression for the header of an array without fields, exactly as NumPy writes it.

Its groups are the type, whether the order of the axes is Fortran's, and the lengths of the axes."""

_MAGIC = b"\x93NUMPY\x01\x00"
"""The first bytes of an array in version 1.0 of NumPy's format."""


class _Header(NamedTuple):
    """The header of an array in NumPy's file format.

    - `dtype`, `shape`: type and shape of the array.
    - `is_column_major`: whether the first axis varies fastest in the data.
    - `length`: number of bytes of the header, after which the data begins.
    """

    dtype: np.dtype
    shape: tuple[int, ...]
    is_column_major: bool
    length: int


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """Read all arrays of an `.npz` file, by name; they contain real numbers or booleans.

    Raises `ValueError`, with a message of one line, if the file cannot be read, is damaged or too
    large, or has an entry that is not such an array. The message names the file and, if a single
    entry is at fault, the entry.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            _check_directory(entries)
            return {_array_name(entry): _read_array(archive, entry) for entry in entries}
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror or error}.") from None
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        # A zip file begins with this mark and ends with its directory, which writers add last.
        if _begins_with(path, b"PK\x03\x04") and not zipfile.is_zipfile(path):
            size = path.stat().st_size
            raise ValueError(
                f"{path}: not a complete .npz file: it is cut short after {size} bytes, before the "
                "directory of its arrays."
            ) from None
        reason = " ".join(str(error).split()) or "it is cut short"
        raise ValueError(f"{path}: not a complete .npz file: {_printable(reason)}.") from None
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    except (struct.error, LookupError, NotImplementedError, RuntimeError) as error:
        # `zipfile` raises these for broken records, file names and compression methods.
        reason = type(error).__name__
        raise ValueError(f"{path}: not a complete .npz file ({reason}).") from None


def _begins_with(path: Path, mark: bytes) -> bool:
    """Whether the first bytes of a file are equal to `mark`."""
    with path.open("rb") as file:
        return file.read(len(mark)) == mark


def _array_name(entry: zipfile.ZipInfo) -> str:
    """The name of the array in an entry of the zip file: the file name without `.npy`."""
    return entry.filename.removesuffix(".npy")


def _check_directory(entries: list[zipfile.ZipInfo]) -> None:
    """Raise `ValueError` unless the entries of a zip file may be read.

    There must be at most `_MAX_ENTRIES` of them, with distinct names that end in `.npy`, and at
    most `MAX_BYTES` in all after unpacking. They must not be encrypted, and be stored or deflated.
    """
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
        is_readable = entry.compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
        is_encrypted = entry.flag_bits & 1
        if not is_readable or is_encrypted:
            name = _printable(_array_name(entry))
            raise ValueError(f"`{name}` must be stored or deflated, without a password.")


def _read_array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    """Read one array; raise `ValueError` if its header and the zip directory disagree.

    `ValueError` is also raised for a header that `_read_header` refuses, for damaged data, and for
    booleans other than 0 and 1; `EOFError` for data that is cut short. `zipfile` unpacks no more
    bytes than the directory says.
    """
    name = _printable(_array_name(entry))
    try:
        with archive.open(entry) as file:
            header = _read_header(name, file)
            size = math.prod(header.shape) * header.dtype.itemsize
            if header.length + size != entry.file_size:
                raise ValueError(
                    f"`{name}` must have {size} bytes of data, as its header says; it has "
                    f"{entry.file_size - header.length}."
                )
            data = file.read(size)
            # `zipfile` compares the checksum when the end is read.
            if len(data) != size or file.read(1):
                raise EOFError(f"`{name}` is cut short")
    except zipfile.BadZipFile:
        raise ValueError(f"`{name}` is damaged: its checksum or its header differs.") from None
    except zlib.error:
        raise ValueError(f"`{name}` is damaged: it cannot be unpacked.") from None
    array = np.frombuffer(data, header.dtype).copy()
    if header.dtype.kind == "b" and (array.view(np.uint8) > 1).any():
        raise ValueError(f"`{name}` must hold booleans, 0 or 1.")
    return array.reshape(header.shape, order="F" if header.is_column_major else "C")


def _read_header(name: str, file: Any) -> _Header:
    """Read the header of an array from `file`, an entry of the zip file, open for reading bytes.

    Afterwards `file` is at the first byte of the array's data. `name`: name of the array, for the
    message. Raises `ValueError` for anything but an array of real numbers or booleans, and for a
    header that is not written as NumPy writes it. The caller compares the header with the directory
    of the zip file.
    """
    start = file.read(len(_MAGIC) + 2)
    length = int.from_bytes(start[len(_MAGIC) :], "little")
    match = _HEADER_PATTERN.fullmatch(file.read(length)) if start.startswith(_MAGIC) else None
    if match is None:
        raise ValueError(f"`{name}` must be an array as NumPy saves it; its header differs.")
    type_name, order, sizes = match.groups()
    type_name = type_name.decode("latin-1")
    try:
        dtype = np.dtype(type_name)
    except (TypeError, ValueError, SyntaxError):
        # NumPy parses some types, such as ",f4", with Python's parser.
        dtype = None
    if dtype is None or dtype.kind not in "biuf" or dtype.fields or dtype.subdtype:
        raise ValueError(f"`{name}` must be an array of numbers; got {_printable(type_name)!r}.")
    shape = tuple(int(size) for size in sizes.replace(b",", b" ").split())
    return _Header(dtype, shape, order == b"True", len(start) + length)


def _printable(text: str) -> str:
    """Cut a text to 80 characters, and replace unprintable characters by question marks."""
    return "".join(c if c.isprintable() else "?" for c in text[:80])
