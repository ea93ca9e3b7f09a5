"""Browsers for tests: Chromium or Chrome, if installed, and scripts that stand in for one."""

import os
from pathlib import Path

import pytest

from softras2d.comparison.chromium import BROWSERS, find_browser

REQUIRE = "SOFTRAS2D_REQUIRE_BROWSER"
"""Environment variable under which a missing browser fails a test instead of skipping it."""


def require_browser() -> str:
    """The browser's path; without one the calling test is skipped, or fails under `REQUIRE`."""
    path = find_browser()
    if path is None:
        message = f"no browser: none of {', '.join(BROWSERS)} is installed"
        (pytest.fail if os.environ.get(REQUIRE) else pytest.skip)(message)
    return path


def fake_browser(folder: Path, script: str) -> str:
    """Write a shell script that is started like a browser; returns its path.

    In `script`, `$picture` is the file to which the browser should write its screenshot.
    """
    path = folder / "fake-browser"
    find = 'for word; do case "$word" in --screenshot=*) picture="${word#*=}";; esac; done'
    path.write_text(f"#!/bin/sh\n{find}\n{script}\n")
    path.chmod(0o755)
    return str(path)
