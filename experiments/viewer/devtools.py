"""A page of Chromium that is controlled by its DevTools protocol, and that nothing else observes.

Playwright receives a copy of every message of a page, even if no script asks for it. With pictures
of megabytes, copying takes as long as the viewer takes to answer, on the same cores.
"""

import itertools
import json
import re
import shutil
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from websockets.sync.client import ClientConnection, connect

from tests.cases.browser import require_browser

_SECONDS = 300.0
"""Longest time to wait for a picture, in seconds; its program may have to be compiled."""

_HAS_VIEWER = """document.querySelector(".sr-viewer") !== null"""

_FINAL_STATE = """new Promise((done) => {
  const viewer = document.querySelector(".sr-viewer");
  const check = () => {
    if (!["exact", "error"].includes(viewer.dataset.state)) return;
    observer.disconnect();
    done(viewer.dataset.state);
  };
  const observer = new MutationObserver(check);
  observer.observe(viewer, {attributes: true, attributeFilter: ["data-state"]});
  check();
})"""
"""Waits in the page: questions to the page would take time on the cores that draw."""

_PRESS = """document.querySelector(".sr-stage").dispatchEvent(
  new KeyboardEvent("keydown", {key: %s, bubbles: true}))"""


class Page:
    """A page that shows the viewer."""

    def __init__(self, connection: ClientConnection):
        self._connection = connection
        self._numbers = itertools.count(1)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Call a method of the protocol; returns its result."""
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": parameters}
        self._connection.send(json.dumps(message))
        while True:
            reply = json.loads(self._connection.recv(_SECONDS))
            if reply.get("id") == number:
                return reply["result"]

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression; if it is a promise, wait for it."""
        options = {"awaitPromise": True, "returnByValue": True}
        return self.call("Runtime.evaluate", expression=expression, **options)["result"].get(
            "value"
        )

    def resize(self, height: int, width: int) -> None:
        """Set the size of the page in pixels."""
        size = {"height": height, "width": width, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **size)

    def press(self, key: str) -> None:
        """Press a key of the viewer, and wait until the exact picture is shown."""
        self.evaluate(_PRESS % json.dumps(key))
        self.wait_for_picture()

    def wait_for_picture(self) -> None:
        """Wait until the exact picture is shown."""
        # The page reacts to a key within a few frames.
        time.sleep(0.1)
        until = time.monotonic() + _SECONDS
        while not self.evaluate(_HAS_VIEWER):
            assert time.monotonic() < until, f"waited {_SECONDS} s for the page"
            time.sleep(0.02)
        state = self.evaluate(_FINAL_STATE)
        assert state == "exact", self.evaluate('document.querySelector(".sr-status").innerText')


@contextmanager
def open_page(url: str) -> Iterator[Page]:
    """Start a separate Chromium without a window, and open a page in it."""
    folder = tempfile.mkdtemp()
    options = ["--headless=new", "--no-sandbox", "--remote-debugging-port=0", "--hide-scrollbars"]
    browser = subprocess.Popen(
        [require_browser(), *options, f"--user-data-dir={folder}", url],
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        with connect(_page_address(browser), max_size=None) as connection:
            yield Page(connection)
    finally:
        browser.kill()
        browser.wait()
        shutil.rmtree(folder, ignore_errors=True)


def _page_address(browser: "subprocess.Popen[str]") -> str:
    """Address at which the first page of a newly started browser takes commands."""
    assert browser.stderr is not None
    for line in browser.stderr:
        if found := re.search(r"DevTools listening on ws://([^/]+)/", line):
            break
    else:
        raise RuntimeError("Chromium did not start.")
    while True:
        with urllib.request.urlopen(f"http://{found[1]}/json") as answer:
            for target in json.load(answer):
                if target["type"] == "page":
                    return target["webSocketDebuggerUrl"]
        time.sleep(0.05)
