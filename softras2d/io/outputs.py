"""Lists the image formats that can be written, and checks paths to write to.

The module imports only the standard library, so that the command line can check its arguments
before it loads JAX and OpenImageIO.
"""

from pathlib import Path

WRITABLE = (".png", ".exr", ".jpg", ".jpeg", ".tif", ".tiff")
"""Suffixes that `write_image` accepts in either case, listed in lower case."""


def check_writable_path(path: Path) -> None:
    """Raise `ValueError` if `path` is a folder, or if the folder of `path` does not exist."""
    if path.is_dir():
        raise ValueError(f"{path}: a folder, not a file to write.")
    if not path.parent.is_dir():
        raise ValueError(f"{path}: there is no folder {path.parent}.")
