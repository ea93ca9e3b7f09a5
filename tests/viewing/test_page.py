"""In a real browser, the page shows what `render` draws, byte for byte."""

import re

import numpy as np
import pytest

import softras2d as sr

from ..cases.pages import (
    canvas_of,
    drawn,
    kinds_received,
    press,
    view_of,
    wait_for,
    wait_for_picture,
)
from ..oracles.coverage import Canvas, footprints

pytestmark = [pytest.mark.slow, pytest.mark.browser]


def test_keys_change_what_is_drawn(page, folder):
    steps = [
        ((), sr.Hard(16)),
        (("-", "-", "f"), sr.Hard(4, "top_left")),
        (("c", "c"), sr.Area()),
    ]
    pictures = set()
    for keys, coverage in steps:
        press(page, *keys)
        shown = canvas_of(page)
        expected = drawn(folder, "squares.svg", view_of(page), coverage)
        np.testing.assert_array_equal(shown[..., :3], expected, err_msg=str(coverage))
        assert (shown[..., 3] == 255).all()
        pictures.add(shown.tobytes())
    assert len(pictures) == len(steps)


def test_texture_keys_change_what_is_drawn(page, folder):
    press(page, "-", "-", "-", "2")
    before = canvas_of(page)
    press(page, "p", "l")
    shown = canvas_of(page)
    filter = sr.Filter("nearest", "zero")
    expected = drawn(folder, "stretched.svg", view_of(page), sr.Hard(1), filter)
    np.testing.assert_array_equal(shown[..., :3], expected)
    assert (shown != before).any()
    # The page shows the costs of effects until another view is drawn.
    page.get_by_role("button", name="Measure what each costs").click()
    panel = page.locator(".sr-viewer")
    wait_for(lambda: re.search(r"texture\s*\S[0-9.]+ ms", panel.inner_text()), "a cost")
    press(page, "ArrowLeft")
    assert not re.search(r"texture\s*\S[0-9.]+ ms", panel.inner_text())


def test_wheel_and_drag_move_the_view(page, folder):
    before = view_of(page)
    # The pointer is far from the middle, since zooming by keys is about the middle.
    page.mouse.move(120, 430)
    page.mouse.wheel(0, -400)
    wait_for_picture(page)
    zoomed = view_of(page)
    assert zoomed["zoom"] > 1.5 * before["zoom"]
    scale = zoomed["zoom"] / before["zoom"]
    # The point under the pointer stays in place, up to rounding the view to whole pixels.
    box = page.locator(".sr-picture").bounding_box()
    for axis, pointer in (("x", 120), ("y", 430)):
        at = pointer - box[axis]
        assert abs((before[axis] + at) * scale - at - zoomed[axis]) <= 0.51
    page.mouse.down()
    page.mouse.move(60, 460, steps=4)
    page.mouse.up()
    wait_for_picture(page)
    moved = view_of(page)
    assert (moved["x"] - zoomed["x"], moved["y"] - zoomed["y"]) == (60, -30)
    shown = canvas_of(page)
    expected = drawn(folder, "squares.svg", moved, sr.Hard(16))
    np.testing.assert_array_equal(shown[..., :3], expected)
    press(page, "Space")
    assert view_of(page) == before


def test_the_last_picture_moves_while_the_exact_one_is_drawn(page):
    before = canvas_of(page)
    # Within one frame of the key, before any answer, the page shows the last picture, moved.
    moved = page.evaluate("""() => new Promise((done) => {
        const viewer = document.querySelector(".sr-stage");
        viewer.dispatchEvent(new KeyboardEvent("keydown", {key: "ArrowLeft", bubbles: true}));
        requestAnimationFrame(() => {
            const canvas = document.querySelector(".sr-picture");
            const row = canvas.getContext("2d").getImageData(0, 200, canvas.width, 1).data;
            done([...row]);
        });
    })""")
    row = np.array(moved, np.uint8).reshape(-1, 4)
    np.testing.assert_array_equal(row[64:], before[200, :-64])
    wait_for_picture(page)


def test_the_inspector_shows_the_samples_of_the_oracle(page, folder):
    press(page, "-", "-", "z")
    lens = page.locator(".sr-lens")
    lens.wait_for(state="visible", timeout=180_000)
    # Move to the corner of a square, where edges cross the pixel.
    press(page, *["ArrowRight"] * 3, *["ArrowDown"] * 2)
    view = view_of(page)
    column, row = view["width"] // 2 + 3, view["height"] // 2 + 2
    title = f"Pixel {column + view['x']}, {row + view['y']}"
    wait_for(lambda: title in lens.inner_text(), title)
    reports = [header for header, _ in page.frames_seen if header["kind"] == "inspect"]
    report = reports[-1]
    assert (report["column"], report["row"], report["rate"]) == (column, row, 2)
    side = round(300 * view["zoom"])
    scene = sr.read_svg(folder / "squares.svg", height=side, width=side)
    canvas = Canvas(view["height"], view["width"], 2, origin=(view["x"], view["y"]))
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles)]
    expected = {}
    for triangle, footprint in enumerate(footprints(corners, canvas)):
        inside = np.zeros((canvas.height * 2, canvas.width * 2), bool)
        inside[footprint.rows, footprint.columns] = footprint.inside
        of_pixel = inside[2 * row : 2 * row + 2, 2 * column : 2 * column + 2]
        if of_pixel.any():
            expected[triangle] = set(np.flatnonzero(of_pixel).tolist())
    nearest = dict(list(sorted(expected.items(), reverse=True))[: report["most_layers"]])
    listed = {layer["triangle"]: set(layer["samples"]) for layer in report["layers"]}
    assert listed and listed.items() <= expected.items()
    assert max(listed) == max(nearest)
    rows = page.locator(".sr-lens tbody tr").all_inner_texts()
    first = max(expected)
    assert any(re.match(rf"\s*{first}\s+{len(expected[first])} / 4", text) for text in rows)
    # The pixel on the page is the mean of the samples.
    value = np.array([sample["color"] for sample in report["samples"]]).mean(axis=0)
    assert np.abs(255 * value - canvas_of(page)[row, column, :3]).max() <= 0.51
    wait_for(lambda: "exact area" in lens.inner_text(), "the exact area")


def test_the_slider_shows_two_settings(page, folder):
    press(page, "v")
    view = view_of(page)
    edge = round(0.5 * view["width"])
    shown = canvas_of(page)[..., :3]
    left = drawn(folder, "squares.svg", view, sr.Hard(16))
    right = drawn(folder, "squares.svg", view, sr.Hard(1))
    np.testing.assert_array_equal(shown[:, :edge], left[:, :edge])
    np.testing.assert_array_equal(shown[:, edge:], right[:, edge:])
    assert (left[:, edge:] != right[:, edge:]).any()
    page.get_by_label("Comparison slider").focus()
    page.keyboard.press("Home")
    wait_for(lambda: (canvas_of(page)[..., :3] == right).all(), "the slider at its left end")


def test_comparing_is_turned_off_and_on_again(page, folder):
    plain = canvas_of(page)
    press(page, "v")
    view = view_of(page)
    left = drawn(folder, "squares.svg", view, sr.Hard(16)).astype(int)
    right = drawn(folder, "squares.svg", view, sr.Hard(1)).astype(int)
    edge = round(0.5 * view["width"])
    halves = np.concatenate([left[:, :edge], right[:, edge:]], axis=1)
    np.testing.assert_array_equal(canvas_of(page)[..., :3], halves)
    assert (halves != plain[..., :3]).any()
    press(page, "v")
    np.testing.assert_array_equal(canvas_of(page), plain)
    press(page, "v")
    np.testing.assert_array_equal(canvas_of(page)[..., :3], halves)
    press(page, "d")
    difference = np.minimum(4 * np.abs(left - right), 255)
    np.testing.assert_array_equal(canvas_of(page)[..., :3], difference)
    press(page, "d")
    np.testing.assert_array_equal(canvas_of(page), plain)


def test_the_inspector_is_closed_over_an_image(page):
    stage = page.locator(".sr-stage")
    press(page, "z", "3")
    assert "sr-inspecting" in stage.get_attribute("class")
    press(page, "z")
    assert "sr-inspecting" not in stage.get_attribute("class")
    press(page, "z")
    assert "sr-inspecting" not in stage.get_attribute("class")
    assert "no samples" in page.locator(".sr-toast").inner_text()


def test_a_double_click_zooms(page):
    before = view_of(page)
    page.mouse.dblclick(200, 300)
    wait_for_picture(page)
    assert view_of(page)["zoom"] == pytest.approx(2 * before["zoom"])


def test_an_image_file_is_compared(page, folder):
    press(page, "0")
    page.get_by_label("Compare with").select_option(label="mine.png")
    press(page, "d")
    wait_for(lambda: "pixels differ" in page.locator(".sr-panel").inner_text(), "the difference")
    view = view_of(page)
    other = [h for h, _ in page.frames_seen if h["kind"] == "picture" and h["slot"] == "b"]
    assert other[-1]["plan"] == "an image" and other[-1]["view"] == view
    shown = canvas_of(page)
    x, y = -view["x"], -view["y"]
    inside = shown[y : y + 300, x : x + 300, :3]
    assert inside[:20, :20].any() and not inside[20:, 20:].any()


def test_overlays_leave_the_picture_as_it_is(page):
    before, plain = canvas_of(page), canvas_of(page, ".sr-overlay")
    for key, kind in (("e", "edges"), ("t", "tiles"), ("g", "gradients")):
        press(page, key)
        wait_for(lambda kind=kind: kind in kinds_received(page), kind)
        is_shown = lambda: (canvas_of(page, ".sr-overlay") != plain).sum() > 200  # noqa: E731
        wait_for(is_shown, f"{kind} on the overlay")
        if kind == "tiles":
            overlay = canvas_of(page, ".sr-overlay").astype(int)
            shaded = overlay[(overlay != plain).any(axis=-1)]
            is_warm = shaded[:, 0] > shaded[:, 1] + 50
            assert is_warm.mean() > 0.5, "most of a tile is shaded from orange to red"
        np.testing.assert_array_equal(canvas_of(page), before)
        press(page, key)
        np.testing.assert_array_equal(canvas_of(page, ".sr-overlay"), plain)
    headers = {header["kind"]: header for header, _ in page.frames_seen}
    assert headers["edges"]["triangles"] > 10 and headers["gradients"]["vertices"] > 10
    np.testing.assert_array_equal(canvas_of(page), before)


def test_every_control_is_reached_by_the_keyboard(page):
    seen = []
    page.locator(".sr-stage").focus()
    for _ in range(60):
        page.keyboard.press("Tab")
        seen.append(
            page.evaluate("""() => {
                const element = document.activeElement;
                const box = element.getBoundingClientRect();
                const style = getComputedStyle(element);
                const name = element.getAttribute("aria-label") || element.textContent;
                return [element.tagName, name.trim(), box.width > 0, style.outlineStyle];
            }""")
        )
    names = {name for _, name, *_ in seen}
    assert {"Fit", "1:1", "Inspect", "Compare", "Save", "Copy", "?", "Panel", "Plan"} <= names
    assert any(name.startswith("Samples per pixel") for name in names)
    assert "Compare with" in names
    for tag, name, is_visible, outline in seen:
        # The focus of radio buttons shows on the label beside them.
        if tag in ("BUTTON", "SELECT", "SUMMARY"):
            assert is_visible and outline == "solid", name


def test_the_list_of_keys_opens_and_closes(page):
    page.keyboard.press("?")
    dialog = page.locator("dialog")
    assert "pixel inspector" in dialog.inner_text()
    page.keyboard.press("Escape")
    # A dialog tells that it closed in an event of its own, after the key was handled.
    focused = "() => document.activeElement.className"
    wait_for(lambda: page.evaluate(focused).startswith("sr-stage"), "the focus of the picture")
    assert not dialog.is_visible()


def test_nothing_is_cut_off_at_800_pixels(page):
    page.set_viewport_size({"width": 800, "height": 600})
    wait_for_picture(page)
    overflowing = page.evaluate("""() => [
            ...document.querySelectorAll(".sr-bar button, .sr-bar select, .sr-panel *")
        ].filter((element) => element.getBoundingClientRect().right > innerWidth + 1)
        .map((element) => element.outerHTML.slice(0, 80))""")
    assert overflowing == []
    assert page.evaluate("() => document.documentElement.scrollWidth") <= 800
