"""Errors about image files repeat the words of OpenImageIO without the path of the file."""

from pathlib import Path

import pytest

from softras2d.io.image_errors import reason_text


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        ('Could not open "folder/image" as PNG\nline 2', " (Could not open it as PNG)"),
        ("folder/image is not a FITS file.", " (it is not a FITS file)"),
        ("EXR Error (folder/image): no header", " (EXR Error: no header)"),
        ("corrupt image data", " (corrupt image data)"),
        (" \n", ""),
    ],
)
def test_only_the_path_is_replaced(message, reason):
    assert reason_text(message, Path("folder/image")) == reason
