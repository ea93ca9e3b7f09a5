"""Images of SVG files as a browser draws them, where Chromium or Chrome is installed."""

import contextlib
import os
import shutil
import signal
import subprocess
import tempfile
from pathlib import Path

import numpy as np
import pytest

import softras2d as sr

NAMES = ("chromium", "chromium-browser", "google-chrome")

REQUIRE = "SOFTRAS2D_REQUIRE_BROWSER"
"""Environment variable under which a missing browser fails a test instead of skipping it."""

_SECONDS, _TRIES = 120.0, 2

_OPTIONS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage",
    "--disable-extensions", "--no-first-run", "--hide-scrollbars", "--force-device-scale-factor=1",
    "--force-color-profile=srgb",
)  # fmt: skip

_PAGE = (
    "<!doctype html><body style='margin:0;background:#fff'>"
    "<img src='scene.svg' style='display:block;width:{width}px;height:{height}px'>"
)


def find_browser() -> str | None:
    """The path of the first of `NAMES` that is installed, or None."""
    return next(filter(None, map(shutil.which, NAMES)), None)


def require_browser() -> str:
    """The browser's path; without one the calling test is skipped, or fails under `REQUIRE`."""
    path = find_browser()
    if path is None:
        message = f"no browser: none of {', '.join(NAMES)} is installed"
        (pytest.fail if os.environ.get(REQUIRE) else pytest.skip)(message)
    return path


def screenshot(browser: str, svg: Path, *, height: int, width: int) -> np.ndarray:
    """An SVG file as the browser shows it on a white page, `[height, width, 3]` in 0..1.

    Raises `RuntimeError` if the browser fails twice or does not end in time.
    """
    output = "nothing"
    for _ in range(_TRIES):
        # A browser may still write into its profile as it ends.
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            output = _run(browser, svg, Path(folder), height, width)
            picture = Path(folder) / "picture.png"
            if picture.exists():
                return sr.read_image(picture)[:height, :width, :3]
    raise RuntimeError(f"{browser} made no picture of {svg}: {output}")


def _run(browser: str, svg: Path, folder: Path, height: int, width: int) -> str:
    """Let the browser write `picture.png` into the folder, and return the end of its output."""
    shutil.copy(svg, folder / "scene.svg")
    (folder / "page.html").write_text(_PAGE.format(width=width, height=height))
    command = [
        browser, *_OPTIONS, f"--user-data-dir={folder / 'profile'}",
        # Browser windows have a minimum size, which includes their frames.
        f"--window-size={max(width, 600)},{max(height, 400) + 200}",
        f"--screenshot={folder / 'picture.png'}", (folder / "page.html").as_uri(),
    ]  # fmt: skip
    # The browser starts a new process group, so that all its processes can be killed together.
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, start_new_session=True
    )
    try:
        output, _ = process.communicate(timeout=_SECONDS)
    except subprocess.TimeoutExpired:
        output = b"it did not end"
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
    return output.decode(errors="replace")[-300:]


def psnr(image: np.ndarray, reference: np.ndarray) -> float:
    """Peak signal-to-noise ratio in dB, for a peak of 1."""
    return float(-10.0 * np.log10(np.mean((image - reference) ** 2)))
