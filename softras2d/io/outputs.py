"""Which image files can be written, and whether a path can be. Imports no library.

The command line checks its arguments by this module before it loads JAX and OpenImageIO.
"""

from pathlib import Path

WRITABLE = (".png", ".exr", ".jpg", ".jpeg", ".tif", ".tiff")
"""Suffixes that `write_image` accepts."""


def check_writable_path(path: Path) -> None:
    """Raise `ValueError` if `path` is a folder, or if its folder does not exist."""
    if path.is_dir():
        raise ValueError(f"{path}: a folder, not a file to write.")
    if not path.parent.is_dir():
        raise ValueError(f"{path}: there is no folder {path.parent}.")
