"""A session answers with the pictures that `render` draws, and panning compiles nothing."""

import gc
import gzip
import tracemalloc
import warnings
from typing import Any

import jax
import numpy as np
import pytest

import softras2d as sr
from softras2d.io.pixel_values import to_bytes
from softras2d.viewing.image import Image, pyramid_image
from softras2d.viewing.open_files import open_files
from softras2d.viewing.scene_file import ReadOptions, SceneFile
from softras2d.viewing.scene_in_memory import default_size, enlarge
from softras2d.viewing.session import Session
from softras2d.viewing.settings import Settings
from softras2d.viewing.view import View

from ..cases.marks import slowly
from ..cases.viewing import (
    HEIGHT,
    VIEW,
    WIDTH,
    ask,
    bytes_of,
    pixels_of,
    small_image,
    small_scene,
    small_session,
)

PICTURE_BYTES = 4 * VIEW["height"] * VIEW["width"]


def test_a_picture_equals_render_byte_for_byte():
    (reply,) = ask(small_session(), "picture")
    expected = bytes_of(enlarge(small_scene(), 1.5, 1.5), VIEW, sr.Hard(samples=4))
    shown = pixels_of(reply)
    np.testing.assert_array_equal(shown[..., :3], expected)
    assert (shown[..., 3] == 255).all()
    assert len(np.unique(shown.reshape(-1, 4), axis=0)) > 20
    assert reply.header["view"] == VIEW
    assert reply.header["compile_seconds"] <= reply.header["milliseconds"] / 1000


def test_panning_and_small_zooms_compile_nothing(count_compilations):
    session = small_session()
    ask(session, "picture", view=VIEW)
    pictures = []
    with count_compilations() as compiled:
        for step in range(30):
            zoom = 1.5 * 1.04 ** (step % 10 - 5)
            view = VIEW | {"x": 10 + 3 * step, "y": 5 - 2 * step, "zoom": zoom}
            (reply,) = ask(session, "picture", view=view)
            pictures.append(pixels_of(reply).tobytes())
    assert compiled.names == []
    assert len(set(pictures)) == 30


@pytest.mark.slow
def test_memory_does_not_grow_with_the_views():
    session = small_session()

    def look(steps: range) -> int:
        """The bytes of memory in use after drawing some views and discarding them."""
        for step in steps:
            view = VIEW | {"x": step % 7, "y": step % 5, "zoom": 1.5 * 1.01 ** (step % 9)}
            (reply,) = ask(session, "picture", view=view)
            assert len(reply.payload) == PICTURE_BYTES
        gc.collect()
        on_devices = sum(array.nbytes for array in jax.live_arrays())
        return on_devices + tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        look(range(40))
        memory = [look(range(start, start + 40)) for start in range(40, 240, 40)]
    finally:
        tracemalloc.stop()
    # If views were kept, memory would grow in every round, by 40 pictures. A program that another
    # thread compiles, for this session or an earlier one, adds its bytes in one round alone.
    assert np.diff(memory).min() < 2 * PICTURE_BYTES


@pytest.mark.parametrize(
    ("settings", "coverage"),
    [
        slowly({"samples": 9, "fill_rule": "top_left"}, sr.Hard(9, "top_left")),
        slowly({"coverage": "soft", "soft_width": 1.7}, sr.Soft(1.7)),
        slowly({"coverage": "area"}, sr.Area()),
    ],
)
def test_pictures_of_other_settings_equal_render(settings, coverage):
    (reply,) = ask(small_session(), "picture", settings=settings)
    expected = bytes_of(enlarge(small_scene(), 1.5, 1.5), VIEW, coverage)
    difference = np.abs(pixels_of(reply)[..., :3].astype(int) - expected.astype(int))
    # The session's plan for wider edges has other tiles, so sums are rounded in another order.
    assert difference.max() <= (coverage == sr.Soft(1.7))


@pytest.mark.slow
def test_a_background_with_alpha_is_sent_with_straight_alpha():
    scene = small_scene()
    scene = sr.Scene.from_soup(
        scene.positions[scene.triangles], scene.colors, background=[0.1, 0.2, 0.3, 0.25]
    )
    from softras2d.viewing.scene_in_memory import SceneInMemory

    session = Session([SceneInMemory("glass", scene, HEIGHT, WIDTH)])
    (reply,) = ask(session, "picture", settings={"samples": 4})
    expected = bytes_of(enlarge(scene, 1.5, 1.5), VIEW, sr.Hard(samples=4))
    np.testing.assert_array_equal(pixels_of(reply), expected)
    assert len(np.unique(expected[..., 3])) > 2


def test_an_image_is_shown_pixel_for_pixel_at_zoom_1():
    image = Image("image", small_image)
    view = View(1.0, -2, 3, HEIGHT, WIDTH)
    shown = image.pixels(view)
    np.testing.assert_array_equal(shown[:-3, 2:, :3], to_bytes(small_image())[3:, :-2])
    assert (shown[:, :2] == 0).all() and (shown[-3:] == 0).all()
    assert (shown[:-3, 2:, 3] == 255).all()


def test_an_enlarged_image_repeats_pixels_and_a_shrunk_one_averages_them():
    image = Image("image", small_image)
    larger = image.pixels(View(3.0, 0, 0, 3 * HEIGHT, 3 * WIDTH))
    expected = to_bytes(small_image()).repeat(3, 0).repeat(3, 1)
    np.testing.assert_array_equal(larger[..., :3], expected)
    smaller = image.pixels(View(0.5, 0, 0, HEIGHT // 2, WIDTH // 2))
    mean = small_image().reshape(HEIGHT // 2, 2, WIDTH // 2, 2, 3).mean(axis=(1, 3))
    assert np.abs(smaller[..., :3] - 255 * mean).max() <= 0.51


def test_the_levels_of_textures_lie_side_by_side():
    texels = np.zeros((4, 8, 3), np.float32)
    texels[:, :4] = 1
    shown = pyramid_image("textures", sr.TexturePyramid.build([texels]))
    # Levels with widths of 8, 4, 2 and 1 texels lie side by side, one pixel apart.
    assert shown.size() == (4, 8 + 4 + 2 + 1 + 3)
    pixels = shown.pixels(View(1.0, 0, 0, *shown.size()))
    assert pixels[0, :9].tolist() == [[255] * 4] * 4 + [[0, 0, 0, 255]] * 4 + [[0] * 4]
    assert pixels[0, 17].tolist() == [128, 128, 128, 255]


def test_a_file_is_read_again_when_it_changes(tmp_path):
    path = tmp_path / "scene.svg"
    drawing = (
        '<svg xmlns="http://www.w3.org/2000/svg" width="{w}" height="10">'
        '<rect width="4" height="5" fill="red"/></svg>'
    )
    path.write_text(drawing.format(w=20))
    file = SceneFile(path, ReadOptions())
    before = file.version
    assert file.size() == (10, 20)
    assert np.asarray(file.scene_at(3.0).positions).max() == 15
    path.write_text(drawing.format(w=40))
    assert file.version != before
    assert file.size() == (10, 40)
    path.unlink()
    assert file.version == 0
    with pytest.raises(ValueError, match="No such file"):
        file.size()


def test_what_is_not_drawn_becomes_a_note_and_no_warning(tmp_path):
    path = tmp_path / "scene.svg"
    path.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9">'
        '<text>not drawn</text><rect width="4" height="5"/></svg>'
    )
    session = Session(open_files([path], ReadOptions()))
    # All threads share Python's warning filters, so this code must issue no warning at all.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        session.subjects[0].scene_at(1.0)
    (note,) = session.subjects[0].notes()
    assert "scene.svg" in note and "text" in note


def test_compressed_drawings_are_read(tmp_path):
    path = tmp_path / "scene.svgz"
    text = '<svg xmlns="http://www.w3.org/2000/svg" width="9" height="8"><path d="M0 0h9v9"/></svg>'
    path.write_bytes(gzip.compress(text.encode()))
    (subject,) = open_files([path], ReadOptions())
    assert subject.size() == (8, 9)
    assert subject.scene_at(1).triangles.shape[0] == 1


def test_a_missing_file_is_an_error_of_its_subject_alone(tmp_path):
    session = Session([SceneFile(tmp_path / "none.svg", ReadOptions()), Image("i", small_image)])
    (reply,) = ask(session, "subjects")
    first, second = reply.header["subjects"]
    assert "No such file" in first["error"]
    assert (second["height"], second["width"]) == (HEIGHT, WIDTH)


def test_a_broken_file_does_not_empty_the_page(monkeypatch):
    session = small_session()

    def fail() -> tuple[int, int]:
        raise KeyError("size")

    monkeypatch.setattr(session.subjects[0], "size", fail)
    (reply,) = ask(session, "subjects")
    first, second = reply.header["subjects"]
    assert "size" in first["error"] and (second["height"], second["width"]) == (HEIGHT, WIDTH)


def test_images_are_listed_by_their_headers_and_two_are_kept(tmp_path, monkeypatch):
    paths = [tmp_path / f"{number}.png" for number in range(3)]
    for number, path in enumerate(paths):
        sr.write_image(path, small_image()[: 10 + number])
    read: list[str] = []
    monkeypatch.setattr(
        "softras2d.viewing.image.read_image", lambda path: read.append(path.name) or small_image()
    )
    session = Session(open_files(paths, ReadOptions()))
    (reply,) = ask(session, "subjects")
    assert [subject["height"] for subject in reply.header["subjects"]] == [10, 11, 12]
    assert read == []
    for number in (0, 1, 0, 2, 0, 1):
        ask(session, "picture", subject=number)
    assert read == ["0.png", "1.png", "2.png", "1.png"]


@pytest.mark.slow
def test_the_python_code_of_a_fit_draws_the_same_picture(tmp_path):
    path = tmp_path / "fit.npz"
    sr.fit(small_image(), triangles=6, steps=2, size=WIDTH).save(path)
    session = Session(open_files([path], ReadOptions()))
    (reply,) = ask(session, "picture", view=VIEW | {"zoom": 1.37})
    names: dict[str, Any] = {}
    exec(reply.header["command"], names)
    image = np.asarray(names["image"], np.float32)
    np.testing.assert_array_equal(pixels_of(reply)[..., :3], to_bytes(image)[..., :3])
    assert len(np.unique(image)) > 3


def test_the_copied_command_does_not_replace_an_image_of_the_scene(tmp_path):
    path = tmp_path / "scene.svg"
    path.write_text('<svg xmlns="http://www.w3.org/2000/svg" width="4" height="4"/>')
    command = SceneFile(path, ReadOptions()).command(View(**VIEW), Settings())
    assert " -o scene-view.png " in command


def test_the_default_canvas_holds_all_triangles():
    scene = sr.Scene.from_soup([[[0, 0], [9.5, 3], [2, 7.2]]], [[1, 0, 0]])
    assert default_size(scene) == (8, 10)
    assert default_size(sr.Scene.from_soup([], [])) == (1, 1)
