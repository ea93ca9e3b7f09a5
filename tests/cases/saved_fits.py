"""Small saved fits of every kind, read as arrays by NumPy alone, for tests that damage them."""

import functools
import io
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

import softras2d as sr

from .pictures import blobs

TARGET = blobs(16, 20)

_CLEAR = np.concatenate(
    [TARGET, np.linspace(0, 1, 320, dtype=np.float32).reshape(16, 20, 1)], axis=-1
)

_WEIGHTS = np.linspace(0, 1, 320).reshape(16, 20)

KINDS: dict[str, dict[str, Any]] = {
    "layers": {"steps": 40, "triangles": 8},
    "glass": {
        "target": _CLEAR, "translucent": True, "shading": "gouraud", "size": 12,
        "weights": _WEIGHTS,
    },
    "mesh": {"family": "mesh", "steps": 40},
    "linear": {"family": "mesh", "shading": "linear", "solver": "lm"},
}  # fmt: skip
"""The options of `fit` for each kind of fit."""


@functools.cache
def saved(kind: str) -> dict[str, np.ndarray]:
    """The arrays in the file of a fit of this kind, by name."""
    options = dict(KINDS[kind])
    target = options.pop("target", TARGET)
    result = sr.fit(target, **{"triangles": 6, "steps": 2, **options})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fit.npz"
        result.save(path)
        with np.load(path) as archive:
            return {name: archive[name] for name in archive.files}


def target_of(kind: str) -> np.ndarray:
    """The image that a fit of this kind was fitted to."""
    return KINDS[kind].get("target", TARGET)


def packed(arrays: dict[str, np.ndarray]) -> bytes:
    """The bytes of an `.npz`."""
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)  # pyright: ignore[reportArgumentType]
    return file.getvalue()


def bomb(header: str, size: int) -> bytes:
    """A small `.npz` that unpacks to an array `image` with this header and `size` zero bytes."""
    file = io.BytesIO()
    padded_header = header.encode().ljust(117) + b"\n"
    with (
        zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("image.npy", "w", force_zip64=True) as entry,
    ):
        entry.write(b"\x93NUMPY\x01\x00" + len(padded_header).to_bytes(2, "little") + padded_header)
        block = bytes(2**20)
        for _ in range(size >> 20):
            entry.write(block)
        entry.write(bytes(size % 2**20))
    return file.getvalue()
