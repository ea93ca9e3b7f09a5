"""The command line: options, files, errors and exit codes, with a stand-in for drawing.

The stand-in replaces reading, planning and drawing, so that most of these tests compile nothing.
Tests on real scenes follow at the end.
"""

import os
import signal
import subprocess
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace

import jax
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import softras2d as sr
from softras2d import scenes
from softras2d.cli import app, demo, options, render_steps
from softras2d.io.contact_sheet import Strip, contact_sheet
from softras2d.io.images import read_image
from softras2d.numerics import compilation_cache

COMMAND = [sys.executable, "-m", "softras2d"]

EDGE = """<svg xmlns="http://www.w3.org/2000/svg" width="4" height="1">
<rect width="1.5" height="1"/></svg>"""


@pytest.fixture
def stand_in(monkeypatch):
    """Draw grey images; files named `bad` or `bug` fail, and `slow` is interrupted."""
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
        height, width = render_steps.canvas_size(asked.size, (30, 40))
        return SimpleNamespace(triangles=np.zeros((7, 3))), height, width

    monkeypatch.setattr(render_steps, "read_scene", read)
    monkeypatch.setattr(
        render_steps, "make_plan", lambda scene, height, width, asked: (height, width)
    )
    monkeypatch.setattr(
        render_steps, "render_image", lambda scene, plan: np.full((*plan, 3), 0.5, np.float32)
    )
    return views


def run(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_version_is_printed():
    result = run("--version")
    assert result.exit_code == 0 and result.stdout == f"softras2d {sr.__version__}\n"


@pytest.mark.parametrize("command", [(), ("render",), ("compare",), ("info",), ("demo",)])
def test_help_has_an_example(command):
    result = run(*command, "--help")
    assert result.exit_code == 0
    assert f"softras2d {''.join(command) or 'demo'} " in result.stdout


def test_one_scene_into_a_file(stand_in, tmp_path):
    result = run("render", "a.svg", "-o", tmp_path / "a.png")
    assert result.exit_code == 0 and result.stderr == ""
    assert "40 x 30 pixels at 16 samples per pixel, 7 triangles" in result.stdout
    assert read_image(tmp_path / "a.png").shape == (30, 40, 3)


def test_every_option_is_passed_on(stand_in, tmp_path):
    result = run(
        "render", "a.svg", "-o", tmp_path / "a.png", "--samples", 4, "--size", "64x48",
        "--dialect", "course", "--fill-rule", "top_left", "--shading", "pixel",
        "--pixel-filter", "nearest", "--level-filter", "zero", "--assets", "img", "--no-frame",
        "--no-opacity", "--linear", "--truncate", "--origin", "-5,3", "--background", "#336699",
        "--tolerance", "0.1", "--strict", "--fit", "cover",
    )  # fmt: skip
    assert result.exit_code == 0, result.stderr
    assert stand_in == [
        options.RenderOptions(
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
            tolerance=0.1,
            strict=True,
            fit="cover",
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


def test_unexpected_errors_are_one_line_and_the_batch_continues(stand_in, tmp_path, monkeypatch):
    result = run("render", "bad.svg", "bug.svg", "a.svg", "-o", tmp_path)
    assert result.exit_code == 1 and (tmp_path / "a.png").exists()
    bad, bug = [line for line in result.stderr.splitlines() if line.startswith("error: ")]
    assert bad == "error: bad.svg: line 3: mismatched tag"
    assert bug.startswith("error: bug.svg: unexpected ZeroDivisionError: a fault of ours (SOFTRAS")
    monkeypatch.setenv("SOFTRAS2D_DEBUG", "1")
    assert isinstance(run("render", "bug.svg", "-o", tmp_path).exception, ZeroDivisionError)
    assert isinstance(run("render", "bad.svg", "-o", tmp_path).exception, ValueError)


def test_warnings_are_one_line_each(stand_in, tmp_path):
    result = run("render", "odd.svg", "odd2.svg", "-o", tmp_path)
    assert result.exit_code == 0
    lines = [line for line in result.stderr.splitlines() if line.startswith("warning: ")]
    assert lines == [f"warning: {n}.svg: circle, path are not supported" for n in ("odd", "odd2")]


def test_interruption_is_one_line_and_exit_code_130(stand_in, tmp_path):
    result = run("render", "a.svg", "slow.svg", "-o", tmp_path / "out")
    assert result.exit_code == 130
    assert result.stderr.splitlines()[-1] == "interrupted"
    result = run("render", "bad.svg", "slow.svg", "-o", tmp_path / "out")
    assert "bad.svg" in result.stderr.splitlines()[-2]
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["a.png"]


def test_sizes_are_parsed_and_fit_the_drawing():
    drawing_size = (30, 40)
    assert render_steps.canvas_size(None, drawing_size) == drawing_size
    assert render_steps.canvas_size(options.parse_size("800x600"), drawing_size) == (600, 800)
    assert render_steps.canvas_size(options.parse_size("800"), drawing_size) == (600, 800)
    assert render_steps.canvas_size(options.parse_size("7"), (1000, 1)) == (7, 1)
    with pytest.raises(typer.BadParameter):
        options.parse_size("-3")


def test_colours_are_parsed():
    assert options.parse_color("transparent") == (0, 0, 0, 0)
    assert options.parse_color("rgba(255, 0, 0, 0.5)") == (1, 0, 0, 0.5)
    assert options.parse_color("rgb(300, -5, 0)") == (1, 0, 0, 1)


class TestOnRealScenes:
    def test_render_writes_what_the_package_draws(self, tmp_path):
        scene_file, target = scenes.path("squares"), tmp_path / "squares.png"
        # Without --fit, a square scene in another size gives a warning.
        asked = (
            "--samples", 4, "--size", "40x30", "--fit", "contain", "--truncate", "--origin", "3,-2",
        )  # fmt: skip
        result = run("render", scene_file, "-o", target, *asked)
        assert result.exit_code == 0 and result.stderr == ""
        scene = sr.read_svg(scene_file, height=30, width=40)
        plan = sr.plan(scene, height=30, width=40, coverage=sr.Hard(samples=4), origin=(3, -2))
        image = np.asarray(sr.render(scene, plan))
        np.testing.assert_array_equal(read_image(target), np.floor(image * 255) / np.float32(255))

    def test_linear_light_over_a_given_background(self, tmp_path):
        (tmp_path / "a.svg").write_text(EDGE)
        result = run(
            "render", tmp_path / "a.svg", "-o", tmp_path / "a.png", "--linear", "--samples", 4,
            "--background", "white",
        )  # fmt: skip
        assert result.exit_code == 0, result.stderr
        row = read_image(tmp_path / "a.png")[0, :, 0] * 255
        # Half black, half white is half of the light, 187.5 in sRGB, not 127.5.
        np.testing.assert_array_equal(row, [0, 188, 255, 255])

    def test_a_transparent_background_gives_alpha(self, tmp_path):
        (tmp_path / "a.svg").write_text(EDGE)
        asked = ("--samples", 4, "--background", "transparent")
        result = run("render", tmp_path / "a.svg", "-o", tmp_path / "a.png", *asked)
        assert result.exit_code == 0, result.stderr
        row = read_image(tmp_path / "a.png")[0]
        np.testing.assert_array_equal(row[:, 3] * 255, [255, 128, 0, 0])
        assert row[:, :3].max() == 0

    def test_info_prints_the_plan(self):
        result = run("info", scenes.path("joints"), "--samples", 4, "--size", 64)
        assert result.exit_code == 0, result.stderr
        scene = sr.read_svg(scenes.path("joints"), height=64, width=64)
        plan = sr.plan(scene, height=64, width=64, coverage=sr.Hard(samples=4))
        assert str(plan) in result.stdout
        assert "flat, opaque" in result.stdout and "300 x 300" in result.stdout

    @pytest.mark.slow
    def test_info_prices_each_effect(self):
        result = run("info", scenes.path("glass"), "--cost", "--samples", 1, "--size", 32)
        assert result.exit_code == 0, result.stderr
        assert "this scene" in result.stdout
        assert "without translucency" in result.stdout and "MiB" in result.stdout

    @pytest.mark.slow
    def test_demo_draws_each_scene_as_drawn_alone(self, tmp_path, monkeypatch):
        monkeypatch.setattr(scenes, "names", lambda: ("joints", "squares"))
        monkeypatch.setattr(demo, "_SAMPLE_COUNTS", (4,))
        result = run("demo", tmp_path / "out")
        assert result.exit_code == 0, result.stderr
        assert f"2 pictures in {tmp_path / 'out'}" in result.stdout
        names = {"joints-4.png", "squares-4.png", "contact_sheet.png"}
        assert {path.name for path in (tmp_path / "out").iterdir()} == names
        # The demo pads this scene to the size of the other one, and draws both by one plan.
        scene = scenes.read("joints")
        plan = sr.plan(scene, height=300, width=300, coverage=sr.Hard(samples=4))
        image = np.floor(np.asarray(sr.render(scene, plan)) * 255 + 0.5) / np.float32(255)
        np.testing.assert_array_equal(read_image(tmp_path / "out" / "joints-4.png"), image)

    @pytest.mark.slow
    def test_a_second_process_compiles_nothing(self, tmp_path):
        cached = []
        command = [*COMMAND, "render", str(scenes.path("squares")), "--size", "40", "-o"]
        for name in ("first.png", "second.png"):
            done = subprocess.run([*command, str(tmp_path / name)], check=True)
            assert done.returncode == 0
            cached.append(sorted(compilation_cache.cache_folder().iterdir()))
        assert cached[0] == cached[1] and len(cached[0]) > 0

    @pytest.mark.slow
    def test_processes_share_a_cache_and_survive_a_broken_one(self, tmp_path):
        command = [*COMMAND, "render", str(scenes.path("squares")), "--size", "32", "-s", "1", "-o"]
        running = [
            subprocess.Popen([*command, str(tmp_path / f"{i}.png")], stderr=subprocess.PIPE)
            for i in range(3)
        ]
        assert [process.communicate()[1] for process in running] == [b""] * 3
        for entry in compilation_cache.cache_folder().iterdir():
            os.truncate(entry, entry.stat().st_size // 2)
        done = subprocess.run([*command, str(tmp_path / "3.png")], capture_output=True, check=True)
        assert done.stderr == b""
        assert len({(tmp_path / f"{i}.png").read_bytes() for i in range(4)}) == 1


class TestAsAProcess:
    def test_an_error_is_one_line_and_exit_code_one(self, tmp_path):
        command = [*COMMAND, "render", "none.svg", "-o", str(tmp_path / "a.png")]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 1 and done.stdout == ""
        assert done.stderr.startswith("error: none.svg: ") and done.stderr.count("\n") == 1

    @pytest.mark.skipif(sys.platform == "win32", reason="needs named pipes and SIGINT")
    def test_ctrl_c_is_one_line_and_exit_code_130(self, tmp_path):
        pipe = tmp_path / "endless.svg"
        os.mkfifo(pipe)
        command = [*COMMAND, "render", str(pipe), "-o", str(tmp_path / "a.png")]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        # `open` returns when the command has opened the other end. The command then waits for text.
        with pipe.open("wb"):
            process.send_signal(signal.SIGINT)
            output, errors = process.communicate(timeout=60)
        assert (process.returncode, output, errors) == (130, b"", b"interrupted\n")
        assert not (tmp_path / "a.png").exists()


class TestContactSheet:
    def test_contains_every_image_unchanged_and_text(self):
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
        # Above the first image there is only text, which is dark.
        assert sheet[:50].min() < 0.5

    def test_without_images_is_refused(self):
        with pytest.raises(ValueError, match="at least one"):
            contact_sheet([])

    def test_every_image_needs_a_caption(self):
        strip = Strip("joints", "", ["a"], [np.zeros((2, 2, 3), np.float32)] * 2)
        with pytest.raises(AssertionError, match="joints: one caption per image"):
            contact_sheet([strip])


def cache_dir():
    return jax.config.values["jax_compilation_cache_dir"]


class TestCompilationCache:
    def test_is_private_in_the_users_folder(self, tmp_path):
        folder = compilation_cache.cache_folder()
        assert folder.is_relative_to(tmp_path / "cache" / "softras2d")
        compilation_cache.keep_compiled_programs()
        assert cache_dir() == str(folder)
        assert folder.stat().st_mode & 0o077 == 0

    def test_ignores_a_relative_xdg_folder(self, monkeypatch, tmp_path):
        monkeypatch.setenv("XDG_CACHE_HOME", "here")
        monkeypatch.setenv("HOME", str(tmp_path))
        assert compilation_cache.cache_folder().is_relative_to(tmp_path)

    def test_does_not_replace_a_folder_that_was_chosen(self, tmp_path):
        jax.config.update("jax_compilation_cache_dir", str(tmp_path))
        compilation_cache.keep_compiled_programs()
        assert cache_dir() == str(tmp_path)

    def test_is_not_used_where_it_cannot_be_created(self, monkeypatch, tmp_path):
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
        monkeypatch.setattr(compilation_cache, "_MAX_BYTES", 900)
        compilation_cache.keep_compiled_programs()
        assert sorted(path.name for path in folder.iterdir()) == [f"{i}-cache" for i in range(4)]
