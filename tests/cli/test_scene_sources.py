"""Where the command line reads scenes from, and where it writes images to."""

import gzip
import io
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from softras2d import scenes
from softras2d.cli import app, render_steps
from softras2d.cli.options import RenderOptions, Size
from softras2d.cli.view import open_subjects
from softras2d.io.images import decode_image
from softras2d.viewing.scene_file import ReadOptions
from softras2d.viewing.settings import Settings
from softras2d.viewing.view import View

SQUARE = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 20 20"{}>'
    '<rect width="20" height="10" fill="red"/></svg>'
)


@pytest.fixture
def grey(monkeypatch):
    """Draw grey images, so that nothing is compiled."""
    monkeypatch.setattr(
        render_steps, "make_plan", lambda scene, height, width, asked: (height, width)
    )
    monkeypatch.setattr(
        render_steps, "render_image", lambda scene, plan: np.full((*plan, 3), 0.5, np.float32)
    )


def run(*arguments, **keywords):
    return CliRunner().invoke(app, [str(argument) for argument in arguments], **keywords)


def read(path, **options):
    return render_steps.read_scene(Path(path), RenderOptions(**options))


@pytest.mark.parametrize("name", ["rings", "ground", "hairlines"])
def test_bundled_scenes_have_names(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scene, height, width = read(name)
    assert (height, width) == (scenes.SIZE, scenes.SIZE)
    assert scene.triangles.shape == scenes.read(name).triangles.shape
    # A file of the same name takes precedence over a bundled scene.
    Path(name).write_text(SQUARE.format(' width="20" height="20"'))
    assert read(name)[1:] == (20, 20)


@pytest.mark.parametrize("name", ["rings", "hairlines", "ground"])
def test_the_viewer_knows_bundled_scenes(name, tmp_path, monkeypatch):
    """The scenes are stored as a file, stored in the course's dialect, or made by a function."""
    monkeypatch.chdir(tmp_path)
    drawing = Path("square.svgz")
    drawing.write_bytes(gzip.compress(SQUARE.format("").encode()))
    other, subject = open_subjects([drawing, Path(name)], ReadOptions())
    assert other.size() == (20, 20)
    assert subject.size() == (scenes.SIZE, scenes.SIZE)
    np.testing.assert_array_equal(subject.scene_at(1).triangles, scenes.read(name).triangles)
    # A file of the same name takes precedence over a bundled scene.
    Path(name).write_text("")
    with pytest.raises(ValueError, match=name):
        open_subjects([Path(name)], ReadOptions())[0].size()


def test_standard_input_and_output(grey, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    text = SQUARE.format(' width="20" height="20"')
    result = run("render", "-", "-o", "-", input=text.encode())
    assert result.exit_code == 0, result.stderr
    assert decode_image(result.stdout_bytes, "stdout").shape == (20, 20, 3)
    assert "20 x 20 pixels" in result.stderr
    assert [path.name for path in tmp_path.iterdir() if path.name != "cache"] == []


def test_the_viewer_reads_standard_input(monkeypatch):
    text = SQUARE.format(' width="20" height="20"').encode()
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(text)))
    (subject,) = open_subjects([Path("-")], ReadOptions())
    assert subject.size() == (20, 20) and not subject.may_change
    # Standard input can be read only once, but its drawing is shown at every zoom.
    for zoom in (1, 3):
        assert subject.scene_at(zoom).triangles.shape[0] == 2
    command = subject.command(View(zoom=3.0, x=0, y=0, height=30, width=40), Settings())
    assert command.startswith("softras2d render - -o stdin-view.png --size 60x60 ")
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(b"<svg")))
    with pytest.raises(ValueError, match=r"^-:1: "):
        open_subjects([Path("-")], ReadOptions())


def test_several_scenes_do_not_go_to_standard_output(grey):
    result = run("render", "rings", "glass", "-o", "-")
    assert result.exit_code == 1 and "2 scenes go into a folder" in result.stderr


def test_standard_input_is_read_once(monkeypatch):
    data = gzip.compress(SQUARE.format("").encode())
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(data)))
    scene, height, width = read("-", size=Size(40, None))
    assert (height, width) == (40, 40) and scene.triangles.shape[0] == 2


def test_a_file_without_a_size_says_which_option_gives_it(tmp_path):
    path = tmp_path / "a.svg"
    path.write_text('<svg xmlns="http://www.w3.org/2000/svg"/>')
    with pytest.raises(ValueError, match=r"a\.svg: <svg> gives no size .*: use --size"):
        read(path)


def test_margins_are_announced_and_chosen(tmp_path):
    path = tmp_path / "a.svg"
    path.write_text(SQUARE.format(' width="20" height="20"'))
    with pytest.warns(
        UserWarning, match=r"drawn with margins, because the drawing is 20 x 20; use --fit"
    ):
        scene, *_ = read(path, size=Size(80, 40))
    assert np.asarray(scene.positions).max(axis=0).tolist() == [60, 20]
    for fit, corner in (("contain", [60, 20]), ("cover", [80, 20]), ("stretch", [80, 20])):
        scene, *_ = read(path, size=Size(80, 40), fit=fit)
        assert np.asarray(scene.positions).max(axis=0).tolist() == corner
    assert np.asarray(scene.positions).min(axis=0).tolist() == [0, 0]


def test_margins_follow_from_the_declared_size_before_rounding(tmp_path):
    path = tmp_path / "a.svg"
    path.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="20.4" height="10.2">'
        '<rect width="20" height="10" fill="red"/></svg>'
    )
    # A warning, which would announce margins, is an error in tests.
    assert read(path, size=Size(200, 100))[1:] == (100, 200)


@pytest.mark.parametrize(
    "attributes, size",
    [
        ('width="20" height="10"', Size(40, 40)),
        ('width="20" height="20" preserveAspectRatio="none"', Size(80, 40)),
        ('width="20" height="20" preserveAspectRatio="xMidYMid slice"',
         Size(80, 40)),
    ],
)  # fmt: skip
def test_a_drawing_that_fills_the_canvas_is_not_announced(attributes, size, tmp_path, recwarn):
    path = tmp_path / "a.svg"
    path.write_text(SQUARE.format(f" {attributes}"))
    read(path, size=size)
    assert not recwarn.list


def test_info_of_a_drawing_without_a_size(tmp_path):
    path = tmp_path / "a.svg"
    path.write_text(SQUARE.format(""))
    result = run("info", path, "--size", "20x20")
    assert result.exit_code == 0 and "size in file" in result.stdout and "none" in result.stdout


@pytest.mark.parametrize("options", [[], ["--tiled"]])
def test_an_error_about_the_output_does_not_name_the_input(options, grey, tmp_path):
    path = tmp_path / "a.svg"
    path.write_text(SQUARE.format(' width="20" height="20"'))
    result = run("render", path, "-o", tmp_path / "none" / "a.png", *options)
    assert result.exit_code == 1
    assert "none" in result.stderr and "a.svg" not in result.stderr


def test_strict_and_tolerance(grey, tmp_path):
    path = tmp_path / "a.svg"
    path.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="20" height="20">\n<text/>'
        '<circle r="15"/></svg>'
    )
    lenient = run("render", path, "-o", tmp_path / "a.png", "--tolerance", 0.5)
    assert lenient.exit_code == 0 and "not drawn: <text>" in lenient.stderr
    strict = run("render", path, "-o", tmp_path / "b.png", "--strict")
    assert strict.exit_code == 1 and "a.svg:2: <text> not drawn" in strict.stderr
    result = run("render", path, "-o", tmp_path / "a.png", "--tolerance", 0)
    assert result.exit_code == 1 and "`tolerance` must be" in result.stderr
