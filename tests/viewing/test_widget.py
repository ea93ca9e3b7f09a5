"""The notebook widget answers messages, and works in a real JupyterLab."""

import base64
import json
import os
import queue
import re
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import softras2d as sr
from softras2d.io.pixel_values import to_bytes

from ..cases.pages import canvas_of, running_browser, wait_for, wait_for_picture
from ..cases.viewing import HEIGHT, VIEW, WIDTH, bytes_of, small_image, small_scene

CELL = """\
import numpy as np
import softras2d as sr

corners = np.float32([[[8, 8], [56, 10], [20, 40]], [[30, 4], [60, 44], [10, 30]]])
scene = sr.Scene.from_soup(corners, [[0.8, 0.2, 0.1], [0.1, 0.3, 0.7]])
sr.view(scene, height=48, width=64, widget_height=420)
"""


@pytest.fixture
def widget() -> Iterator[Any]:
    widget = sr.view(small_scene(), small_image(), height=HEIGHT, width=WIDTH, widget_height=240)
    yield widget
    widget.close()


def test_messages_are_answered(widget, monkeypatch):
    answers: queue.Queue[tuple[dict[str, Any], Any]] = queue.Queue()
    monkeypatch.setattr(widget, "send", lambda content, buffers: answers.put((content, buffers)))
    widget._receive(widget, {"kind": "subjects", "id": 1, "owner": "a"}, [])
    content, buffers = answers.get(timeout=60)
    assert [subject["name"] for subject in content["subjects"]] == ["scene 1", "image 2"]
    assert (content["owner"], buffers) == ("a", None)
    request = {"kind": "picture", "id": 2, "owner": "b", "view": VIEW, "subject": 1}
    widget._receive(widget, request, [])
    content, (payload,) = answers.get(timeout=60)
    assert (content["owner"], content["id"]) == ("b", 2)
    assert len(payload) == 4 * VIEW["height"] * VIEW["width"]
    # Neither closing an output nor invalid messages end the widget.
    widget._receive(widget, {"kind": "closed", "owner": "b"}, [])
    widget._receive(widget, "nonsense", [])
    widget._receive(widget, {"kind": "subjects", "owner": "a"}, [])
    assert answers.get(timeout=60)[0]["kind"] == "subjects"


def test_widgets_share_one_thread_and_closing_one_leaves_the_others(widget, monkeypatch):
    def threads() -> list[str]:
        names = [thread.name for thread in threading.enumerate()]
        return sorted(name for name in names if name.startswith("softras2d"))

    answers: queue.Queue[str] = queue.Queue()
    others = [sr.view(small_image(), widget_height=240) for _ in range(3)]
    for name, shown in zip("abcd", (widget, *others), strict=True):
        deliver = lambda content, buffers, name=name: answers.put(name)  # noqa: E731
        monkeypatch.setattr(shown, "send", deliver)
        # Outputs of different widgets may have the same name.
        shown._receive(shown, {"kind": "subjects", "owner": "a"}, [])
    assert {answers.get(timeout=60) for _ in range(4)} == set("abcd")
    assert threads().count("softras2d viewer") == 1
    for other in others:
        other.close()
    widget._receive(widget, {"kind": "subjects", "owner": "a"}, [])
    assert answers.get(timeout=60) == "a"


def test_outputs_are_told_of_a_changed_file(tmp_path, monkeypatch):
    path = tmp_path / "image.png"
    sr.write_image(path, small_image())
    widget = sr.view(path, small_image(), widget_height=240)
    answers: queue.Queue[dict[str, Any]] = queue.Queue()
    monkeypatch.setattr(widget, "send", lambda content, buffers=None: answers.put(content))
    widget._receive(widget, {"kind": "subjects", "owner": "a"}, [])
    before = answers.get(timeout=60)["subjects"][0]
    sr.write_image(path, small_image()[:20])
    told = answers.get(timeout=60)
    assert told["kind"] == "changed" and told["versions"][0] != before["version"]
    assert told["versions"][1] == 1 and "owner" not in told
    widget._receive(widget, {"kind": "subjects", "owner": "a"}, [])
    assert answers.get(timeout=60)["subjects"][0]["height"] == 20
    # Once the output is closed, a changed file sends no message.
    widget._receive(widget, {"kind": "closed", "owner": "a"}, [])
    sr.write_image(path, small_image()[:10])
    with pytest.raises(queue.Empty):
        answers.get(timeout=1.2)
    widget.close()


def test_the_saved_output_has_a_picture(widget, tmp_path):
    bundle, _ = widget._repr_mimebundle_()
    assert "application/vnd.jupyter.widget-view+json" in bundle
    path = tmp_path / "still.png"
    path.write_bytes(base64.b64decode(bundle["image/png"]))
    shown = to_bytes(sr.read_image(path))
    assert shown.shape == (240, 320, 3)
    scale = np.float32(5)
    scene = sr.Scene.from_soup(
        small_scene().positions[small_scene().triangles] * scale,
        small_scene().colors,
        background=[0.8, 0.8, 0.8],
    )
    view = {"height": 240, "width": 320, "x": 0, "y": 0}
    np.testing.assert_array_equal(shown, bytes_of(scene, view, sr.Hard(16)))
    assert widget.still == f"data:image/png;base64,{bundle['image/png']}"


@pytest.mark.parametrize(
    ("subjects", "keywords", "told"),
    [
        ([], {}, "nothing to view"),
        ([3], {}, "subject 0 must be a scene"),
        ([np.zeros((2, 2, 3), np.uint8)], {}, "an image holds floats"),
        (["none.svg"], {}, "none.svg: no such file"),
        ([np.zeros((2, 2, 3), np.float32)], {"widget_height": 10}, "`widget_height` must be 200"),
    ],
)
def test_what_cannot_be_viewed_is_refused(subjects, keywords, told):
    with pytest.raises(ValueError, match=re.escape(told)):
        sr.view(*subjects, **keywords)


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[str]:
    """The address of a JupyterLab with one notebook, `view.ipynb`, in `tmp_path`."""
    pytest.importorskip("jupyterlab")
    cell = {"cell_type": "code", "metadata": {}, "outputs": [], "execution_count": None, "id": "a"}
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    notebook = {
        "cells": [cell | {"source": CELL}],
        "metadata": {"kernelspec": kernel},
        "nbformat": 4,
        "nbformat_minor": 5,
    }
    (tmp_path / "view.ipynb").write_text(json.dumps(notebook))
    command = [
        sys.executable, "-m", "jupyterlab", "--no-browser", "--allow-root", "--port=0",
        "--IdentityProvider.token=viewer", f"--ServerApp.root_dir={tmp_path}",
    ]  # fmt: skip
    homes = {"JUPYTERLAB_WORKSPACES_DIR": str(tmp_path / "workspaces")}
    log = tmp_path / "lab.log"
    with log.open("wb") as file:
        process = subprocess.Popen(command, stdout=file, stderr=file, env=os.environ | homes)
    try:
        wait_for(lambda: re.search(r"http://\S+/lab", log.read_text()), "JupyterLab")
        address = re.search(r"http://[^/\s]+", log.read_text())
        assert address is not None
        yield f"{address.group()}/lab/tree/view.ipynb?token=viewer"
    finally:
        # The server is killed, because when it is asked to end it sometimes waits minutes for
        # kernels and pages. The kernel ends by itself.
        process.kill()
        process.wait(60)


@pytest.mark.slow
@pytest.mark.browser
def test_the_widget_in_jupyterlab(lab, tmp_path):
    with running_browser() as browser:
        page = browser.new_page(viewport={"width": 1200, "height": 900})
        page.goto(lab)
        page.locator(".jp-Notebook .jp-CodeCell").first.wait_for(timeout=180_000)
        # JupyterLab forgets a cell that is run before its kernel has started.
        page.get_by_text("| Idle").wait_for(timeout=180_000)
        page.locator(".jp-CodeCell .cm-content").first.click()
        page.keyboard.press("Shift+Enter")
        page.locator(".sr-viewer .sr-picture").wait_for(timeout=180_000)
        wait_for_picture(page)
        stage = page.locator(".sr-stage")
        stage.click(position={"x": 200, "y": 300})
        wait_for_picture(page)
        before = canvas_of(page)
        assert len(np.unique(before.reshape(-1, 4), axis=0)) > 10
        # Keys must reach the widget, not JupyterLab, whose command mode would cut the cell at x.
        for key in ("-", "-", "-", "x"):
            page.keyboard.press(key)
        wait_for_picture(page)
        after = canvas_of(page)
        assert set(map(tuple, np.unique(after.reshape(-1, 4), axis=0).tolist())) == {
            (204, 51, 26, 255), (26, 77, 179, 255), (255, 255, 255, 255),
        }  # fmt: skip
        text = page.locator(".jp-CodeCell .cm-content").first.inner_text()
        assert text.split() == CELL.split()
        # The picture for pages without a kernel is hidden while the widget runs.
        image = page.locator(".jp-OutputArea img[src^='data:image/png']:not(.sr-still)")
        assert image.count() == 1 and not image.is_visible()
        page.keyboard.press("Control+s")
        saved = tmp_path / "view.ipynb"
        wait_for(lambda: "image/png" in saved.read_text(), "the saved notebook")
        # Without its kernel the notebook still shows the picture.
        address, _, _ = lab.partition("/lab")
        kernels = page.request.get(f"{address}/api/kernels?token=viewer").json()
        for kernel in kernels:
            page.request.delete(f"{address}/api/kernels/{kernel['id']}?token=viewer")
        page.goto("about:blank")
        page.goto(lab)
        image.first.wait_for(state="visible", timeout=180_000)
    notebook = json.loads(saved.read_text())
    first, _ = notebook["cells"][0]["outputs"]
    assert base64.b64decode(first["data"]["image/png"]).startswith(b"\x89PNG")
