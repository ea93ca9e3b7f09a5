"""Screenshots of the viewer in Chromium, for the README."""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

import softras2d as sr
from softras2d import pictures, scenes
from softras2d.viewing.image import image_file
from softras2d.viewing.open_files import fit_subject, open_files
from softras2d.viewing.scene_file import ReadOptions
from softras2d.viewing.serve import ViewerServer
from softras2d.viewing.session import Session
from tests.cases.pages import running_browser, wait_for, wait_for_picture

RESULTS = Path(__file__).parent / "results"
WINDOW = {"width": 1120, "height": 720}


def main() -> None:
    """Write the PNG files of `results`, or only `inspector.png`, which needs no fit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--inspector", action="store_true", help="Only the pixel inspector.")
    only_inspector = parser.parse_args().inspector
    sr.keep_compiled_programs()
    files = [scenes.path(name) for name in ("wheel", "glass", "stretched", "joints")]
    subjects = open_files(files, ReadOptions())
    if not only_inspector:
        target = sr.read_image(pictures.path("valley"))
        fit = sr.fit(target, triangles=120, size=96, steps=400, seed=0)
        subjects += [fit_subject("valley.npz", fit), image_file(pictures.path("valley"))]
    with ViewerServer(Session(subjects)) as server, running_browser() as browser:
        page = browser.new_page(viewport=WINDOW)
        _inspect(page, server.url)
        page.close()
        if only_inspector:
            return
        page = browser.new_page(viewport=WINDOW, color_scheme="dark")
        _compare(page, server.url)
        _fit(page)
        page.close()
        page = browser.new_page(viewport={"width": 800, "height": 560})
        _narrow(page, server.url)
        page.close()


def _inspect(page: Any, url: str) -> None:
    """Show the lens over a pixel in which several triangles meet."""
    page.goto(url)
    wait_for_picture(page)
    _press(page, "2", "-", "i", "i", "i", "z")
    lens = page.locator(".sr-lens")
    wait_for(lens.is_visible, "the lens")
    box = page.locator(".sr-stage").bounding_box()
    page.mouse.click(box["width"] * 0.379, box["height"] * 0.4665)
    wait_for(lambda: "exact area" in lens.inner_text(), "the exact area")
    _save(page, "inspector")


def _compare(page: Any, url: str) -> None:
    """Compare one sample per pixel with 16, with a slider between both images."""
    page.goto(url)
    wait_for_picture(page)
    _press(page, "1", "r", "r", "v")
    _save(page, "compare")
    _press(page, "v", "R", "R")


def _fit(page: Any) -> None:
    """Show a fit with its triangles, the gradients of its error, and the curve of the fit."""
    _press(page, "5", "e", "g")
    wait_for(lambda: page.locator(".sr-fit").is_visible(), "the curve")
    time.sleep(20)
    _save(page, "fit")


def _narrow(page: Any, url: str) -> None:
    """Show tiles and how full they are, in a window 800 pixels wide."""
    page.goto(url)
    wait_for_picture(page)
    _press(page, "4", "t")
    time.sleep(3)
    _save(page, "tiles")


def _press(page: Any, *keys: str) -> None:
    for key in keys:
        page.keyboard.press(key)
    wait_for_picture(page)


def _save(page: Any, name: str) -> None:
    """Write a screenshot with a small palette, so that the file is small."""
    path = RESULTS / f"{name}.png"
    time.sleep(0.5)
    page.screenshot(path=path)
    image = sr.read_image(path)[..., :3]
    sr.write_image(path, np.round(image * 63) / np.float32(63))


if __name__ == "__main__":
    main()
