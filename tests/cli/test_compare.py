"""`softras2d compare`: exit codes, printed and written results, drawings as inputs, and errors."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import softras2d as sr
from softras2d.cli import app, options, render_steps

GREY = np.full((6, 7, 3), 0.2, np.float32)


@pytest.fixture
def files(tmp_path):
    """A folder with `a.png`, `same.png`, `close.png` (one level off) and `other.png`."""
    other = GREY.copy()
    other[2, 3] = 0.6
    for name, image in {"a": GREY, "same": GREY, "close": GREY + 1 / 255, "other": other}.items():
        sr.write_image(tmp_path / f"{name}.png", image)
    return tmp_path


def run(*arguments):
    return CliRunner().invoke(app, ["compare", *map(str, arguments)])


def test_images_that_match_exit_with_0(files):
    result = run(files / "a.png", files / "same.png", "--tolerance", 0)
    assert result.exit_code == 0 and result.stderr == ""
    assert result.stdout.startswith(f"{files / 'a.png'} matches {files / 'same.png'}\n")
    assert "0 of 42 (0 %)" in result.stdout and "infinite" in result.stdout


def test_the_tolerance_decides(files):
    assert run(files / "close.png", files / "a.png").exit_code == 0
    assert run(files / "close.png", files / "a.png", "--tolerance", 0.003).exit_code == 1
    assert run(files / "other.png", files / "a.png", "--tolerance", 0.5).exit_code == 0


def test_images_that_differ_exit_with_1_and_leave_a_picture(files):
    result = run(files / "other.png", files / "a.png", "-o", files / "difference.png")
    assert result.exit_code == 1 and result.stderr == ""
    assert f"{files / 'other.png'} differs from {files / 'a.png'}\n" in result.stdout
    assert "1 of 42" in result.stdout and "row 2, column 3: 0.4" in result.stdout
    assert f"difference: {files / 'difference.png'}\n" in result.stdout
    picture = sr.read_image(files / "difference.png")
    assert picture.shape == (6, 7, 3) and picture[2, 3, 0] > 0.75 > 0.3 > picture[0].max()


def test_a_picture_is_compared_with_the_exact_image_of_a_drawing(files):
    """The black rectangle ends at x = 1.2, right of one of the four columns of samples."""
    drawing = files / "edge.svg"
    drawing.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="4" height="1">'
        '<rect width="1.2" height="1"/></svg>'
    )
    row = np.array([0, 0.75, 1, 1], np.float32).reshape(1, 4, 1)
    sr.write_image(files / "row.png", row)
    result = run(files / "row.png", drawing, "--tolerance", 0)
    assert result.exit_code == 0, result.stdout + result.stderr


def test_the_options_of_a_drawing_are_passed_on(files, monkeypatch):
    asked = []

    def read(path, settings):
        asked.append((path, settings))
        return None, settings.size.height, settings.size.width

    monkeypatch.setattr(render_steps, "read_scene", read)
    monkeypatch.setattr(render_steps, "make_plan", lambda *_: None)
    monkeypatch.setattr(render_steps, "render_image", lambda *_: GREY)
    drawing = Path("scene.SVG")
    assert run(files / "a.png", drawing).exit_code == 0
    assert run(files / "a.png", drawing, "--against", 64, "--dialect", "course").exit_code == 0
    size = options.Size(width=7, height=6)
    assert asked == [
        (drawing, options.RenderOptions(samples=16, size=size)),
        (drawing, options.RenderOptions(samples=64, size=size, dialect="course")),
    ]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("none.png", "a.png"), "none.png: no such file."),
        (("a.png", "small.png"), "a.png and small.png must have the same size; got 7 x 6 and"),
        (("a.png", "a.png", "--against", "4"), "a.png: --against applies to an .svg drawing only."),
        (("a.svg", "a.png"), "a.svg: the image to test cannot be a drawing"),
        (("a.png", "a.svg", "--against", "5"), "--against must be one of 1, 4, 9, 16, 64, 256"),
        (("a.png", "a.png", "-o", "a.txt"), "a.txt: the suffix must be one of .png"),
    ],
)
def test_errors_are_one_line_and_exit_with_2(files, monkeypatch, arguments, message):
    monkeypatch.chdir(files)
    sr.write_image("small.png", GREY[1:])
    (files / "a.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg" width="7" height="6"/>')
    result = run(*arguments)
    assert result.exit_code == 2
    assert result.stderr.startswith("error: ") and message in result.stderr
    assert result.stderr.count("\n") == 1


def test_wrong_usage_exits_with_2(files):
    assert run(files / "a.png").exit_code == 2
    assert run(files / "a.png", files / "a.png", "--tolerance", -1).exit_code == 2
