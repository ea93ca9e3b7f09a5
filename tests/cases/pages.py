"""A real browser that shows the viewer, driven by playwright."""

import base64
import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import softras2d as sr

from .browser import REQUIRE, require_browser
from .viewing import bytes_of, unpacked

WINDOW = {"width": 920, "height": 560}
"""Size of a browser page, in pixels."""

SECONDS = 180.0
"""Longest time to wait for a picture, in seconds: its program may compile on a busy machine."""

_CANVAS = """(selector) => {
  const canvas = document.querySelector(selector);
  const {width, height} = canvas;
  const bytes = canvas.getContext("2d").getImageData(0, 0, width, height).data;
  let text = "";
  for (let at = 0; at < bytes.length; at += 32768) {
    text += String.fromCharCode(...bytes.subarray(at, at + 32768));
  }
  return {width, height, bytes: btoa(text)};
}"""


def require_playwright() -> Any:
    """Playwright's module; without it the calling test is skipped, or fails under `REQUIRE`."""
    try:
        return import_module("playwright.sync_api")
    except ModuleNotFoundError:
        message = "no playwright: pip install '.[browser]'"
        (pytest.fail if os.environ.get(REQUIRE) else pytest.skip)(message)


@contextmanager
def running_browser() -> Iterator[Any]:
    """A playwright browser: the installed Chromium or Chrome, without a window."""
    path, sync_api = require_browser(), require_playwright()
    with sync_api.sync_playwright() as playwright:
        # The browser runs as root in containers, where its sandbox does not work.
        arguments = ["--no-sandbox", "--force-color-profile=srgb"]
        browser = playwright.chromium.launch(executable_path=path, args=arguments)
        yield browser
        browser.close()


def wait_for(is_true: Callable[[], Any], expectation: str) -> None:
    """Wait until a condition holds, and fail the test after `SECONDS`.

    Playwright's own function evaluates strings in the page, which the viewer's policy forbids.
    """
    until = time.monotonic() + SECONDS
    while not is_true():
        assert time.monotonic() < until, f"waited for {expectation}"
        time.sleep(0.05)


def wait_for_picture(page: Any) -> None:
    """Wait until the exact picture is shown."""
    # The page reacts to a key within one frame; only then does its state change.
    page.evaluate("() => new Promise((done) => requestAnimationFrame(() => setTimeout(done, 50)))")
    wait_for(lambda: state_of(page) in ("exact", "error"), "a picture")
    # A page that watches a fit may be waiting for its next picture already.
    assert state_of(page) != "error", page.locator(".sr-status").inner_text()


def state_of(page: Any) -> str:
    """The state of the page's picture: "pending", "exact", "error" or "closed"."""
    return page.locator(".sr-viewer").first.get_attribute("data-state") or ""


def canvas_of(page: Any, selector: str = ".sr-picture") -> np.ndarray:
    """The pixels that a canvas of the page shows, `[height, width, 4]` bytes."""
    shown = page.evaluate(_CANVAS, selector)
    pixels = np.frombuffer(base64.b64decode(shown["bytes"]), np.uint8)
    return pixels.reshape(shown["height"], shown["width"], 4)


def frames_of(page: Any) -> list[tuple[dict[str, Any], bytes]]:
    """A list of (header, payload), to which each message is added that the page receives.

    The pixels of pictures are unpacked, and their parts put together.
    """
    frames: list[tuple[dict[str, Any], bytes]] = []
    parts: list[bytes] = []

    def receive(frame: Any) -> None:
        if isinstance(frame, bytes):
            length = int.from_bytes(frame[:4], "little")
            header, payload = json.loads(frame[4 : 4 + length]), frame[4 + length :]
            parts.append(unpacked(header, payload))
            if header.get("is_last", True):
                frames.append((header, b"".join(parts)))
                parts.clear()

    page.on("websocket", lambda opened: opened.on("framereceived", receive))
    return frames


def view_of(page: Any) -> dict[str, Any]:
    """The view of the last picture in slot "a" that the page received."""
    pictures = [header for header, _ in page.frames_seen if header["kind"] == "picture"]
    return [header for header in pictures if header["slot"] == "a"][-1]["view"]


def drawn(folder: Path, name: str, view: dict[str, Any], coverage: Any, filter: Any = None) -> Any:
    """The RGB bytes that `render` gives for a drawing of 300 x 300 pixels at a view."""
    height, width = (max(1, round(300 * view["zoom"])) for _ in range(2))
    scene = sr.read_svg(folder / name, height=height, width=width)
    return bytes_of(scene, view, coverage, filter)


def kinds_received(page: Any) -> set[str]:
    """The kinds of all messages that the page received so far."""
    # Playwright delivers frames while it waits for an answer of the page.
    page.evaluate("() => 0")
    return {header["kind"] for header, _ in page.frames_seen}


def press(page: Any, *keys: str) -> None:
    """Press keys, and wait for the picture after each."""
    for key in keys:
        page.keyboard.press(key)
    wait_for_picture(page)
