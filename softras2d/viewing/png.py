"""Encodes a picture of bytes as a PNG file."""

import tempfile
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from ..io.images import write_image


def png_of(rgba: UInt8[np.ndarray, "height width 4"]) -> bytes:
    """Encode straight RGBA as a PNG file, without an alpha channel if all pixels are opaque."""
    channels = 3 if (rgba[..., 3] == 255).all() else 4
    image = rgba[..., :channels].astype(np.float32) / np.float32(255)
    # The Python binding of OpenImageIO can write to files only.
    with tempfile.TemporaryDirectory(prefix="softras2d-") as folder:
        path = Path(folder) / "picture.png"
        write_image(path, image)
        return path.read_bytes()
