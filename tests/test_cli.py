"""The command line: wiring, files, errors and exit codes, with pictures from a stand-in.

The stand-in replaces reading, planning and drawing, so these tests compile nothing. The commands on
real scenes are at the end.
"""

import os
import warnings
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from softras2d import __version__
from softras2d.cli import app, compilation_cache, options, view
from softras2d.contact_sheet import Strip, contact_sheet
from softras2d.io.images import read_image


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    """The session's cache folder, and JAX's settings as they were."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.delenv("SOFTRAS2D_DEBUG", raising=False)
    names = (
        "jax_compilation_cache_dir",
        "jax_persistent_cache_min_compile_time_secs",
        "jax_persistent_cache_min_entry_size_bytes",
    )
    before = {name: jax.config.values[name] for name in names}
    yield
    for name, value in before.items():
        jax.config.update(name, value)


@pytest.fixture
def stand_in(monkeypatch):
    """Scenes that are grey, sized as asked; names with `bad` fail, `slow` are interrupted."""
    views = []

    def read(path, asked):
        views.append(asked)
        if "bad" in path.name:
            raise ValueError(f"{path}: line 3:\n mismatched tag")
        if "bug" in path.name:
            raise ZeroDivisionError("a fault of ours")
        if "odd" in path.name:
            warnings.warn(f"{path}: circle, path are not supported", UserWarning, stacklevel=2)
        if "slow" in path.name:
            raise KeyboardInterrupt
        height, width = view.canvas(asked.size, (30, 40))
        return SimpleNamespace(triangles=np.zeros((7, 3))), height, width

    monkeypatch.setattr(view, "read", read)
    monkeypatch.setattr(view, "plan_of", lambda scene, height, width, asked: (height, width))
    monkeypatch.setattr(view, "draw", lambda scene, plan: np.full((*plan, 3), 0.5, np.float32))
    return views


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_version():
    result = run("--version")
    assert result.exit_code == 0 and result.stdout == f"softras2d {__version__}\n"


@pytest.mark.parametrize("command", [(), ("render",), ("info",), ("demo",)])
def test_help_has_an_example(command):
    result = run(*command, "--help")
    assert result.exit_code == 0
    assert f"softras2d {''.join(command) or 'demo'} " in result.stdout


def test_one_scene_into_a_file(stand_in, tmp_path):
    result = run("render", "a.svg", "-o", tmp_path / "a.png")
    assert result.exit_code == 0 and result.stderr == ""
    assert "40 x 30 pixels, 16 samples each, 7 triangles" in result.stdout
    assert read_image(tmp_path / "a.png").shape == (30, 40, 3)


def test_every_option_reaches_the_view(stand_in, tmp_path):
    result = run(
        "render", "a.svg", "-o", tmp_path / "a.png", "--samples", 4, "--size", "64x48",
        "--dialect", "course", "--fill-rule", "top_left", "--shading", "pixel",
        "--pixel-filter", "nearest", "--level-filter", "zero", "--assets", "img", "--no-frame",
        "--no-opacity", "--linear", "--truncate", "--origin", "-5,3", "--background", "#336699",
    )  # fmt: skip
    assert result.exit_code == 0, result.stderr
    assert stand_in == [
        options.View(
            samples=4,
            size=options.Size(64, 48),
            dialect="course",
            assets=Path("img"),
            fill_rule="top_left",
            shading="pixel",
            pixel_filter="nearest",
            level_filter="zero",
            frame=False,
            opacity=False,
            background=options.Color(0.2, 0.4, 0.6, 1.0),
            origin=options.Pixel(-5, 3),
            linear=True,
        )
    ]
    # One half of linear light is 0.7354 in sRGB, 187.5 of 255.
    assert read_image(tmp_path / "a.png")[0, 0, 0] == np.float32(187) / np.float32(255)


def test_many_scenes_into_a_new_folder(stand_in, tmp_path):
    result = run("render", "x/a.svg", "b.svg", "-o", tmp_path / "deep/er", "--format", "exr")
    assert result.exit_code == 0, result.stderr
    assert sorted(path.name for path in (tmp_path / "deep/er").iterdir()) == ["a.exr", "b.exr"]
    assert "2 of 2 images" in result.stdout


@pytest.mark.parametrize("output", ["new/", "old", "old.png"])
def test_one_scene_into_a_folder(stand_in, tmp_path, output):
    (tmp_path / "old").mkdir()
    (tmp_path / "old.png").mkdir()
    result = run("render", "a.svg", "-o", f"{tmp_path}/{output}")
    assert result.exit_code == 0, result.stderr
    assert (tmp_path / output / "a.png").is_file()


def test_one_failing_scene_does_not_stop_the_others(stand_in, tmp_path):
    result = run("render", "a.svg", "bad.svg", "b.svg", "-o", tmp_path / "out")
    assert result.exit_code == 1
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["a.png", "b.png"]
    assert result.stderr.splitlines()[-1] == "error: bad.svg: line 3: mismatched tag"
    assert "2 of 3 images" in result.stdout


def test_errors_are_one_line(stand_in, tmp_path):
    for arguments, message in (
        (("bad.svg", "-o", tmp_path / "a.png"), "bad.svg: line 3: mismatched tag"),
        (("a.svg", "-o", tmp_path / "a.gif"), "suffix must be one of"),
        (("a.svg", "-o", tmp_path / "none/a.png"), "there is no folder"),
        (("a.svg", "b.svg", "-o", tmp_path / "a.png"), "2 scenes go into a folder"),
        (("x/a.svg", "y/a.svg", "-o", tmp_path), "both x/a.svg and y/a.svg"),
    ):
        result = run("render", *arguments)
        assert result.exit_code == 1
        assert result.stderr.startswith("error: ") and message in result.stderr
        assert result.stderr.count("\n") == 1 and result.stdout == ""
    assert [path.name for path in tmp_path.iterdir() if path.suffix] == []


@pytest.mark.parametrize(
    "arguments",
    [
        ("--size", "800x"),
        ("--size", "0"),
        ("--size", "1x2x3"),
        ("--origin", "1"),
        ("--origin", "a,b"),
        ("--background", "blah"),
        ("--dialect", "html"),
    ],
)
def test_misuse_is_exit_code_two(stand_in, tmp_path, arguments):
    result = run("render", "a.svg", "-o", tmp_path / "a.png", *arguments)
    assert result.exit_code == 2 and stand_in == []


def test_no_output_is_misuse(stand_in):
    assert run("render", "a.svg").exit_code == 2


def test_faults_of_ours_keep_their_traceback(stand_in, tmp_path, monkeypatch):
    assert isinstance(run("render", "bug.svg", "-o", tmp_path).exception, ZeroDivisionError)
    monkeypatch.setenv("SOFTRAS2D_DEBUG", "1")
    assert isinstance(run("render", "bad.svg", "-o", tmp_path).exception, ValueError)


def test_warnings_are_one_line_each(stand_in, tmp_path):
    result = run("render", "odd.svg", "odd2.svg", "-o", tmp_path)
    assert result.exit_code == 0
    lines = [line for line in result.stderr.splitlines() if line.startswith("warning: ")]
    assert lines == [f"warning: {n}.svg: circle, path are not supported" for n in ("odd", "odd2")]


def test_interruption_is_one_line_and_130(stand_in, tmp_path):
    result = run("render", "a.svg", "slow.svg", "-o", tmp_path / "out")
    assert result.exit_code == 130
    assert result.stderr.splitlines()[-1] == "interrupted"
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["a.png"]


def test_sizes():
    own = (30, 40)
    assert view.canvas(None, own) == own
    assert view.canvas(options.parse_size("800x600"), own) == (600, 800)
    assert view.canvas(options.parse_size("800"), own) == (600, 800)
    assert view.canvas(options.parse_size("7"), (1000, 1)) == (7, 1)
    with pytest.raises(typer.BadParameter):
        options.parse_size("-3")


def test_colours():
    assert options.parse_color("transparent") == (0, 0, 0, 0)
    assert options.parse_color("rgba(255, 0, 0, 0.5)") == (1, 0, 0, 0.5)


class TestContactSheet:
    def test_holds_every_picture_pixel_for_pixel_and_some_ink(self):
        random = np.random.default_rng(0)
        images = [random.random((20, 30, 3), np.float32) for _ in range(4)]
        sheet = contact_sheet(
            [
                Strip("one", "first", ["a", "b"], images[:2]),
                Strip("two", "second", ["a", "b"], images[2:]),
            ]
        )
        windows = np.lib.stride_tricks.sliding_window_view(sheet, (20, 30, 3))[:, :, 0]
        for image in images:
            corner = np.argwhere((windows[:, :, 0, 0] == image[0, 0]).all(axis=-1))
            assert len(corner) == 1
            np.testing.assert_array_equal(windows[tuple(corner[0])], image)
        # Dark where nothing but type can be: above the first picture.
        assert sheet[:50].min() < 0.5

    def test_needs_a_picture(self):
        with pytest.raises(ValueError, match="at least one"):
            contact_sheet([])


def cache_dir():
    return jax.config.values["jax_compilation_cache_dir"]


class TestCompilationCache:
    def test_is_the_users(self, tmp_path):
        folder = compilation_cache.cache_folder()
        assert folder.is_relative_to(tmp_path / "cache" / "softras2d")
        compilation_cache.keep_compiled_programs()
        assert cache_dir() == str(folder)
        assert folder.stat().st_mode & 0o077 == 0

    def test_ignores_a_relative_xdg_folder(self, monkeypatch, tmp_path):
        monkeypatch.setenv("XDG_CACHE_HOME", "here")
        monkeypatch.setenv("HOME", str(tmp_path))
        assert compilation_cache.cache_folder().is_relative_to(tmp_path)

    def test_leaves_a_folder_that_was_chosen(self, tmp_path):
        jax.config.update("jax_compilation_cache_dir", str(tmp_path))
        compilation_cache.keep_compiled_programs()
        assert cache_dir() == str(tmp_path)

    def test_is_done_without_where_it_cannot_be(self, monkeypatch, tmp_path):
        (tmp_path / "file").write_text("")
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
        compilation_cache.keep_compiled_programs()
        assert cache_dir() is None

    def test_is_bounded(self, monkeypatch):
        folder = compilation_cache.cache_folder()
        folder.mkdir(parents=True)
        for age in range(10):
            (folder / f"{age}-cache").write_bytes(bytes(100))
            os.utime(folder / f"{age}-cache", (1e9 - age, 1e9 - age))
        monkeypatch.setattr(compilation_cache, "_LARGEST", 900)
        compilation_cache.keep_compiled_programs()
        assert sorted(path.name for path in folder.iterdir()) == [f"{i}-cache" for i in range(4)]
