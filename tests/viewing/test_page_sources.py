"""In a real browser, the page follows changing files, running fits, and the end of its server."""

import re
import signal
import subprocess
import sys

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d import scenes
from softras2d.viewing.open_files import open_files
from softras2d.viewing.scene_file import ReadOptions
from softras2d.viewing.scene_in_memory import SceneInMemory
from softras2d.viewing.serve import ViewerServer
from softras2d.viewing.session import Session

from ..cases.pages import (
    WINDOW,
    canvas_of,
    frames_of,
    press,
    state_of,
    view_of,
    wait_for,
    wait_for_picture,
)
from ..cases.viewing import HEIGHT, WIDTH, small_scene

pytestmark = [pytest.mark.slow, pytest.mark.browser]


def test_a_changed_file_is_drawn_again(browser, tmp_path):
    path = tmp_path / "scene.svg"
    drawing = (
        '<svg xmlns="http://www.w3.org/2000/svg" width="60" height="60">'
        '<rect x="10" y="10" width="40" height="40" fill="{color}"/></svg>'
    )
    path.write_text(drawing.format(color="#204060"))
    with ViewerServer(Session(open_files([path], ReadOptions()))) as server:
        page = browser.new_page(viewport=WINDOW)
        page.goto(server.url)
        wait_for_picture(page)
        middle = lambda: canvas_of(page)[300, 280].tolist()  # noqa: E731
        assert middle() == [0x20, 0x40, 0x60, 255]
        path.write_text(drawing.format(color="#a0b0c0"))
        wait_for(lambda: middle() == [0xA0, 0xB0, 0xC0, 255], "the changed file")
        path.write_text("<svg")
        wait_for(lambda: state_of(page) == "error", "an error")
        assert "scene.svg" in page.locator(".sr-status").inner_text()
        path.write_text(drawing.format(color="#102030"))
        wait_for(lambda: middle() == [0x10, 0x20, 0x30, 255], "the repaired file")
        page.close()


def test_a_half_written_file_keeps_the_view(browser, tmp_path):
    path = tmp_path / "scene.svg"
    drawing = scenes.path("squares").read_text()
    path.write_text(drawing)
    with ViewerServer(Session(open_files([path], ReadOptions()))) as server:
        page = browser.new_page(viewport=WINDOW)
        page.frames_seen = frames_of(page)
        page.goto(server.url)
        wait_for_picture(page)
        press(page, "-", "-", "-", "i", "i", "ArrowLeft")
        before, shown = view_of(page), canvas_of(page)
        path.write_text(drawing[: len(drawing) // 2])
        wait_for(lambda: state_of(page) == "error", "an error")
        path.write_text(drawing)
        wait_for(lambda: state_of(page) == "exact", "the whole file")
        assert view_of(page) == before
        np.testing.assert_array_equal(canvas_of(page), shown)
        page.close()


def test_an_image_with_alpha_is_shown_as_it_was_sent(browser):
    scene = small_scene(channels=4)
    scene = eqx.tree_at(lambda s: s.background, scene, jnp.array([0.1, 0.2, 0.3, 0.25]))
    with ViewerServer(Session([SceneInMemory("glass", scene, HEIGHT, WIDTH)])) as server:
        page = browser.new_page(viewport=WINDOW)
        page.frames_seen = frames_of(page)
        page.goto(server.url)
        wait_for_picture(page)
        page.evaluate("() => 0")
        pictures = [frame for frame in page.frames_seen if frame[0]["kind"] == "picture"]
        header, payload = pictures[-1]
        sent = np.frombuffer(payload, np.uint8).reshape(header["height"], header["width"], 4)
        shown = canvas_of(page)
        page.close()
    assert len(np.unique(sent[..., 3])) > 5
    np.testing.assert_array_equal(shown[..., 3], sent[..., 3])
    # A browser canvas stores premultiplied colours in bytes, and so rounds straight colours.
    alpha = sent[..., 3:] / 255
    assert np.abs(shown[..., :3] * alpha - sent[..., :3] * alpha).max() <= 1


def test_pages_are_independent(browser, server, page):
    other = browser.new_page(viewport=WINDOW)
    other.goto(server.url)
    wait_for_picture(other)
    press(other, "i", "i")
    before = canvas_of(page)
    assert not np.array_equal(canvas_of(other), before)
    other.close()
    press(page, "-", "=")
    np.testing.assert_array_equal(canvas_of(page), before)


def test_a_server_that_ends_leaves_its_picture(browser, folder):
    with ViewerServer(Session(open_files([folder / "squares.svg"], ReadOptions()))) as server:
        page = browser.new_page(viewport=WINDOW)
        page.goto(server.url)
        wait_for_picture(page)
        before = canvas_of(page)
    wait_for(lambda: state_of(page) == "closed", "the end")
    assert "has ended" in page.locator(".sr-status").inner_text()
    np.testing.assert_array_equal(canvas_of(page), before)
    page.close()


def test_the_copied_command_draws_the_same_picture(page, folder, tmp_path):
    press(page, "i", "i", "-", "f")
    (header, payload) = [
        (header, payload) for header, payload in page.frames_seen if header["kind"] == "picture"
    ][-1]
    command = header["command"].split()
    assert command[:2] == ["softras2d", "render"]
    command[command.index("-o") + 1] = str(tmp_path / "same.png")
    subprocess.run([sys.executable, "-m", *command], check=True, capture_output=True, timeout=300)
    written = np.round(255 * sr.read_image(tmp_path / "same.png")).astype(np.uint8)
    sent = np.frombuffer(payload, np.uint8).reshape(header["height"], header["width"], 4)
    np.testing.assert_array_equal(written[..., :3], sent[..., :3])
    np.testing.assert_array_equal(canvas_of(page), sent)


def test_a_fit_is_watched(browser, tmp_path):
    output = tmp_path / "fit.svg"
    command = [
        sys.executable, "-m", "softras2d", "fit", "--watch", "--no-browser",
        "-n", "20", "--size", "48", "--steps", "1000000", "-o", str(output),
    ]  # fmt: skip
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        address = re.search(r"http\S+", process.stdout.readline())
        assert address is not None
        page = browser.new_page(viewport=WINDOW)
        page.goto(address.group())
        curve = page.locator(".sr-fit")
        wait_for(lambda: curve.is_visible() and "fitting" in curve.inner_text(), "the curve")
        steps = lambda: int(page.locator(".sr-viewer").get_attribute("data-fit-steps"))  # noqa: E731
        first = steps()
        wait_for(lambda: steps() > first, "more steps")
        wait_for_picture(page)
        assert len(np.unique(canvas_of(page).reshape(-1, 4), axis=0)) > 5
        # Closing the page does not end the fit: it runs on, and another page shows it.
        reached = steps()
        page.close()
        page = browser.new_page(viewport=WINDOW)
        page.goto(address.group())
        curve = page.locator(".sr-fit")
        wait_for(lambda: curve.is_visible() and steps() > reached, "more steps in a second page")
        assert process.poll() is None and "fitting" in curve.inner_text()
        # Ctrl-C ends a fit with the best result so far, which the page shows last.
        process.send_signal(signal.SIGINT)
        wait_for(lambda: "fitted" in curve.inner_text(), "the end of the fit")
        process.wait(120)
        wait_for(lambda: state_of(page) == "closed", "the end")
        page.close()
    finally:
        process.kill()
        process.communicate()
    assert output.is_file()
