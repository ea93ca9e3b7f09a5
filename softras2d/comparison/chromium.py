"""Runs Chromium without a window, to take a picture of an SVG file.

The module imports only the standard library, so that the command line can look for a browser before
it loads JAX and OpenImageIO.
"""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
"""Commands under which Chromium or Chrome is installed, in the order in which they are tried."""

TIME_LIMIT = 120.0
"""Default number of seconds after which a browser that has not ended is killed."""

_TRIES = 2
"""Number of times that a browser is started, if it ends without a picture.

The cause of its failure may be temporary, such as a lack of memory."""

_LONGEST_FOLDER = 58
"""Longest path, in bytes, of a folder in which Chromium can make its socket.

The path of the socket is 45 bytes longer, and macOS allows 103.
"""

_OPTIONS = (
    "--headless", "--disable-gpu", "--disable-dev-shm-usage", "--disable-extensions",
    "--no-first-run", "--hide-scrollbars", "--force-device-scale-factor=1",
    "--force-color-profile=srgb",
    # The sandbox does not start as root or in many containers. An image runs no scripts.
    "--no-sandbox",
    # No name of a host is resolved, and nothing is looked up or updated.
    "--host-resolver-rules=MAP * ~NOTFOUND", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip

_PAGE = (
    "<!doctype html><body style='margin:0;background:#fff'>"
    "<img src='scene.svg' style='display:block;width:{width}px;height:{height}px'>"
)
"""A white page that shows the SVG in its upper left corner."""


def find_browser(name: str = BROWSERS[0]) -> str | None:
    """Find a browser by its command or path; return its path, or None if it is not installed.

    For the name `chromium`, the first of `BROWSERS` that is installed is found.
    """
    names = BROWSERS if name == BROWSERS[0] else (name,)
    return next(filter(None, map(shutil.which, names)), None)


def screenshot_file(
    browser: str, svg: Path, *, height: int, width: int, seconds: int | float = TIME_LIMIT
) -> bytes:
    """Take a picture of an SVG file as the browser shows it; return the bytes of a PNG file.

    The drawing is shown as an image of `width` x `height` pixels, in the upper left corner of the
    picture. The picture may be larger; the rest is white.

    - `browser`: path of Chromium, or of a browser with the same command-line options.
    - `seconds`: time limit, after which the browser is killed. A browser that has ended by itself
      without a picture is started once more, with the same limit.

    After the call, no process of the browser is left; on Windows, child processes of a killed
    browser may be left. No file is left either, with one exception: if the path of the temporary
    folder is longer than `_LONGEST_FOLDER`, a browser that is killed leaves its socket.

    Raises `OSError`, with a message of one line, for a browser that cannot be started or twice ends
    without a picture, and `TimeoutError` for one that does not end in time.
    """
    reason = ""
    for _ in range(_TRIES):
        with _scratch_folder() as folder:
            reason = _run(browser, svg, folder, height, width, seconds)
            picture = folder / "picture.png"
            if picture.exists():
                return picture.read_bytes()
    raise OSError(f"{browser} made no picture of {svg}: {reason}")


@contextmanager
def _scratch_folder() -> Iterator[Path]:
    """Yield a temporary folder for a `with` block, and remove it with its files after that."""
    folder = Path(tempfile.mkdtemp(prefix="softras2d-"))
    try:
        yield folder
    finally:
        # Processes that were killed may still write into their profile for a moment.
        for _ in range(20):
            shutil.rmtree(folder, ignore_errors=True)
            if not folder.exists():
                break
            time.sleep(0.1)


def _run(
    browser: str, svg: Path, folder: Path, height: int, width: int, seconds: int | float
) -> str:
    """Let the browser write `picture.png` into `folder`; return how it ended, as text on one line.

    The arguments, and the error for a browser that does not end in time, are those of
    `screenshot_file`.
    """
    shutil.copy(svg, folder / "scene.svg")
    page, log = folder / "page.html", folder / "output.txt"
    page.write_text(_PAGE.format(width=width, height=height))
    command = [
        browser, *_OPTIONS, f"--user-data-dir={folder / 'profile'}",
        # Browser windows have a minimum size, which includes their frames.
        f"--window-size={max(width, 600)},{max(height, 400) + 200}",
        f"--screenshot={folder / 'picture.png'}", page.as_uri(),
    ]  # fmt: skip
    # Output goes to a file: a pipe would stay open while any process of the browser lives. In a
    # process group of their own, all its processes can be killed together.
    with log.open("wb") as output:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
            env=_environment(folder), start_new_session=True,
        )  # fmt: skip
    try:  # Directly after the start, so that an interrupt ends the browser too.
        code = process.wait(seconds)
    except subprocess.TimeoutExpired:
        raise TimeoutError(f"{browser} made no picture of {svg} within {seconds:g} s.") from None
    finally:
        _kill_group(process)
    lines = log.read_text(encoding="utf-8", errors="replace").split("\n")
    last = next((line.strip() for line in reversed(lines) if line.strip()), "it printed nothing")
    return f"it ended with exit code {code}: {last[-200:]}"


def _environment(folder: Path) -> dict[str, str]:
    """Environment variables with which a browser writes its files into `folder`.

    The exception is its socket, if the path of the folder is too long for one.
    """
    # Crash reports are written into the user's folder of settings, whatever the profile. A profile
    # below that folder would have its cache in the user's folder of caches.
    variables = {"XDG_CONFIG_HOME": str(folder / "settings")}
    # A browser that is killed leaves its socket in the folder of temporary files. Chromium aborts
    # if the path of the socket is too long for the system.
    if len(os.fsencode(folder)) <= _LONGEST_FOLDER:
        variables["TMPDIR"] = str(folder)
    return os.environ | variables


def _kill_group(process: subprocess.Popen[bytes]) -> None:
    """Kill a process and all others of its process group, and wait until it has ended.

    Windows has no process groups: there, the process alone is killed.
    """
    if sys.platform == "win32":
        process.kill()
    else:
        # macOS refuses permission if all processes of the group have ended.
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    process.wait()
