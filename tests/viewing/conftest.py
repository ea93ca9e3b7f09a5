"""Fixtures: a server of two drawings and an image, and its page in a real browser."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import softras2d as sr
from softras2d import scenes
from softras2d.viewing.open_files import open_files
from softras2d.viewing.scene_file import ReadOptions
from softras2d.viewing.serve import ViewerServer
from softras2d.viewing.session import Session

from ..cases.pages import (
    WINDOW,
    frames_of,
    running_browser,
    wait_for_picture,
)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with running_browser() as browser:
        yield browser


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drawings, one with textures, and an image of the first with a changed corner."""
    folder = tmp_path_factory.mktemp("scenes")
    for name in ("squares", "stretched"):
        shutil.copy(scenes.path(name), folder)
    shutil.copytree(scenes.path("squares").parent / "textures", folder / "textures")
    scene = scenes.read("squares")
    image = np.array(sr.render(scene, sr.plan(scene, height=300, width=300)))
    image[:20, :20] = 0
    sr.write_image(folder / "mine.png", image)
    return folder


@pytest.fixture(scope="module")
def server(folder: Path) -> Iterator[ViewerServer]:
    files = [folder / name for name in ("squares.svg", "stretched.svg", "mine.png")]
    with ViewerServer(Session(open_files(files, ReadOptions()))) as server:
        yield server


@pytest.fixture
def page(browser: Any, server: ViewerServer) -> Iterator[Any]:
    """A page that shows the first drawing. Errors on the page fail the test."""
    page = browser.new_page(viewport=WINDOW)
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda message: errors.append(message.text))
    page.on("request", lambda request: errors.append(request.url) if _is_outside(request) else None)
    page.frames_seen = frames_of(page)
    page.goto(server.url)
    wait_for_picture(page)
    yield page
    page.close()
    assert errors == []


def _is_outside(request: Any) -> bool:
    return not request.url.startswith(("http://127.0.0.1:", "ws://127.0.0.1:", "data:", "blob:"))
