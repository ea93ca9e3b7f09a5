"""Compares the SVG of a fit, as a browser shows it, with the image of the fit.

This module imports JAX, so it is imported only while a command runs.
"""

import tempfile
from pathlib import Path

from ..comparison.chromium import find_browser
from ..comparison.screenshot import screenshot, screenshot_difference
from ..fitting.result import FitResult
from .fit_files import write_all
from .fit_options import PictureOptions
from .fit_paths import STANDARD_STREAM, find_suffix


def browser_line(options: PictureOptions, result: FitResult) -> str:
    """Show the SVG of a fit in a browser; return a line on its difference from the fit's image.

    The browser is that of `--compare-in`, which must have been given. The SVG is the first file of
    this kind that the command writes, or else the one on standard output. The image is
    `FitResult.image`, which is the one that is scored, with 16 samples per pixel. Therefore the
    difference includes what the SVG lacks because its colours are gradients, and because of
    `--digits`.

    Raises `OSError`, with a message of one line, if the browser is missing, fails or takes too
    long, and `ValueError` if its picture cannot be decoded.
    """
    assert options.compare_in is not None
    browser = find_browser(options.compare_in)
    if browser is None:
        raise FileNotFoundError(f"--compare-in {options.compare_in}: no longer installed.")
    svg = find_suffix(options.outputs, ".svg")
    with tempfile.TemporaryDirectory(prefix="softras2d-") as folder:
        # A browser cannot read the SVG on standard output, so it is written a second time.
        path = svg or Path(folder) / "fit.svg"
        if svg is None:
            write_all([path], result, None, options.digits)
        shown = screenshot(browser, path, height=result.height, width=result.width)
    return (
        f"{svg or STANDARD_STREAM} in {Path(browser).name}, compared with the fit at 16 samples "
        f"per pixel: {screenshot_difference(shown, result.image)}"
    )
