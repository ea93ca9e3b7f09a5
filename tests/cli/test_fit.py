"""`softras2d fit`: the files it writes, the arguments it refuses, and Ctrl-C."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from typer.testing import CliRunner

import softras2d as sr
from softras2d.cli import app
from softras2d.cli.fit_errors import in_options
from softras2d.io.images import read_image, write_image

from ..cases.pictures import blobs

COMMAND = [sys.executable, "-m", "softras2d", "fit"]


@pytest.fixture
def photo(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setenv("COLUMNS", "200")
    path = tmp_path / "photo.png"
    write_image(path, blobs())
    return path


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["none.png"], "none.png: no such file"),
        (["PHOTO", "-o", "a.txt"], "a.txt: the suffix must be one of .svg"),
        (["PHOTO", "-o", "none/a.svg"], "there is no folder none"),
        (["PHOTO", "-o", "PHOTO"], "that is the picture to fit"),
        (["PHOTO", "--seconds", "-5"], "--seconds must be a number above 0; got -5.0"),
        (["PHOTO", "--seconds", "nan"], "--seconds must be a number above 0; got nan"),
        (
            ["PHOTO", "--softness", "wide"],
            "--softness must be a width in pixels, or FIRST:LAST; got 'wide'",
        ),
        (["PHOTO", "-o", "a.svg", "-o", "a.svg"], "given twice"),
        (["PHOTO", "-n", "0"], "-n must be an integer in 1..2147483647; got 0"),
        (["PHOTO", "--size", "0"], "--size must be an integer in 1..2147483647; got 0"),
        (["PHOTO", "--family", "mesh", "--translucent"], "--translucent is for layers"),
        (
            ["PHOTO", "--colors", "solve", "--loss", "l1"],
            "--colors of 'solve' and 'polish' needs --loss squared",
        ),
        (["PHOTO", "--focus", "90,0,9,9"], "--focus 90,0,9,9 lies outside the picture, 48 x 40"),
        (
            ["PHOTO", "--weights", "PHOTO8"],
            "photo8.png has 8 x 8 pixels; the picture to",
        ),
        (["."], "fit every picture in it with: softras2d fit-batch . -o OUT"),
        (["PHOTO", "PHOTO8"], "photo8.png: more than one picture. For a film of these frames, add"),
        (["--animation", "a.svg"], "a.svg: --animation needs the frames of a film"),
        (["PHOTO", "--animation", "a.mp4"], "the suffix of an animation must be .svg or .gif"),
        (
            ["PHOTO", "--animation", "a.gif", "--seconds", "9", "--family", "mesh"],
            "--family, --seconds: not available for films (--animation)",
        ),
        (
            ["PHOTO", "PHOTO8", "--animation", "a.svg"],
            "photo8.png: 8 x 8 pixels; the first frame, ",
        ),
        (
            ["PHOTO", "--digits", "1", "-o", "a.png", "-o", "a.s2d"],
            "--digits is for SVG files; got no SVG to write, but a.png, a.s2d",
        ),
        (
            ["PHOTO", "PHOTO8", "--digits", "1", "--animation", "a.gif"],
            "--digits is for SVG files; got no SVG to write, but a.gif",
        ),
        (["PHOTO", "--steps", "5", "--seconds", "1"], "give one of --steps and --seconds"),
        (["PHOTO", "--resume", "none.npz"], "none.npz: no such file"),
        (["PHOTO", "--shading", "linear"], "--shading of a layers fit must be one of"),
        (["PHOTO", "--start", "even"], "error, uniform, delaunay, or an .svg or .npz; got 'even'"),
        (["PHOTO", "--palette", "red"], "--palette must be a number of colours, or colours such"),
        (["PHOTO", "--palette", "8", "--shading", "gouraud"], "it needs --shading flat"),
        (["PHOTO", "--background", "red"], "--background must be one of 'mean', 'fit', 'transp"),
        (["PHOTO", "--freeze", "positions,shape"], "--freeze must have names from 'positions'"),
        (["PHOTO", "--freeze", "vertices"], "names from 'positions', 'colors', 'opacity'; got 'v"),
        (["PHOTO", "--freeze", ""], "--freeze must have names from 'positions'"),
        (["PHOTO", "--palette", "0"], "--palette must have from 1 to 256 colours; got 0."),
        (["PHOTO", "--palette", "300"], "--palette must have from 1 to 256 colours; got 300."),
        (["PHOTO", "--start", "none.svg"], "none.svg: cannot be read: No such file"),
        (["PHOTO", "--start", "a.svg", "--family", "mesh"], "or an .npz; got 'a.svg'"),
    ],
)
def test_errors_are_one_line(photo, tmp_path, arguments: list[str], message: str):
    os.chdir(tmp_path)
    write_image("photo8.png", blobs(8, 8))
    files = {"PHOTO": str(photo), "PHOTO8": "photo8.png"}
    done = CliRunner().invoke(app, ["fit", *(files.get(text, text) for text in arguments)])
    assert done.exit_code == 1
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
    assert {p.name for p in tmp_path.iterdir()} <= {"photo.png", "photo8.png", "cache"}


@pytest.mark.parametrize(
    "arguments",
    [["none.png"], ["-n", "0"], ["-o", "a.txt"], ["--start", "even"], ["--compare-in", "none"]],
)
def test_wrong_arguments_are_refused_before_jax_is_loaded(arguments):
    script = f"""
import sys
sys.argv[1:] = {["fit", *arguments]!r}
from softras2d.cli import main
try:
    main()
except SystemExit as stop:
    print(stop.code, "jax" in sys.modules, "OpenImageIO" in sys.modules)
"""
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert done.stdout == "1 False False\n", done.stderr


def test_errors_name_the_options():
    given = {"target": "photo.jpg", "weights": "mask.png", "resume": "fit.npz"}
    for error, message in {
        "`resume` is of 9 x 9 pixels; `target` has 8 x 8.": "--resume fit.npz is of 9 x 9 pixels; "
        "photo.jpg has 8 x 8.",
        "`resume` is of another `target`.": "--resume fit.npz is of another picture than "
        "photo.jpg.",
        "`start` has 9 triangles; `triangles` is 8.": "--start has 9 triangles; -n is 8.",
        "fit with `translucent=True`.": "fit with --translucent.",
        "solvers take `loss='squared'`; use 'adam'.": "solvers take --loss squared; use 'adam'.",
        "`weights` must be finite.": "--weights mask.png must be finite.",
        "`state.host` must be a share.": "`state.host` must be a share.",
    }.items():
        assert in_options(error, given) == message


@pytest.mark.slow
def test_options_that_do_not_apply_to_a_resumed_fit_are_named(photo, tmp_path):
    result = sr.fit(read_image(photo), triangles=2, steps=2)
    result.save(tmp_path / "a.npz")
    # A value that is the default is ignored as well, so the warning names its option, too.
    settings = ["-n", "9", "--seed", "3", "--solver", "adam"]
    command = [str(photo), "--resume", str(tmp_path / "a.npz"), *settings]
    done = CliRunner().invoke(app, ["fit", *command, "--steps", "2", "-o", str(tmp_path / "b.png")])
    assert done.exit_code == 0, done.stderr
    lines = done.stderr.splitlines()
    assert lines[0] == (
        "warning: -n, --solver, --seed: ignored, because --resume takes the settings from the file"
    )
    assert lines[1].startswith("warning: --steps 2: no step is taken, because steps are counted")
    assert len(lines) == 2
    assert "2 triangles" in done.stdout


@pytest.fixture(autouse=True)
def restore_working_folder():
    before = os.getcwd()
    yield
    os.chdir(before)


@pytest.mark.slow
def test_every_kind_of_file_is_written(photo, tmp_path):
    names = ["a.svg", "a.png", "a.gif", "a.npz", "a.json"]
    outputs = [argument for name in names for argument in ("-o", str(tmp_path / name))]
    command = [*COMMAND, str(photo), "-n", "8", "--steps", "50", "--shading", "gouraud", *outputs]
    compact = tmp_path / "a.s2d"
    command += ["-o", str(compact)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "PSNR" in done.stdout
    assert "a browser shows the SVG by linear gradients" in done.stdout
    bits = 8 * compact.stat().st_size / (40 * 48)
    assert f"a.s2d has {compact.stat().st_size} bytes, {bits:.3f} bits per pixel" in done.stdout
    assert sr.read_compact(compact).scene.triangles.shape == (8, 3)
    result = sr.FitResult.load(tmp_path / "a.npz")
    np.testing.assert_allclose(read_image(tmp_path / "a.png"), result.image, atol=0.51 / 255)
    scene = sr.read_svg(tmp_path / "a.svg")
    np.testing.assert_array_equal(
        np.asarray(scene.positions)[np.asarray(scene.triangles)],
        np.asarray(result.scene.positions)[np.asarray(result.scene.triangles)],
    )
    report = json.loads((tmp_path / "a.json").read_text())
    assert report["psnr"] == result.psnr
    assert report["settings"]["triangles"] == 8
    assert (tmp_path / "a.gif").read_bytes()[:6] == b"GIF89a"
    more = [*COMMAND, str(photo), "--resume", str(tmp_path / "a.npz"), "--steps", "75"]
    done = subprocess.run(
        [*more, "-o", str(tmp_path / "b.npz")], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert sr.FitResult.load(tmp_path / "b.npz").history[-1].steps == 75


@pytest.mark.slow
@pytest.mark.parametrize("family", ["layers", "mesh"])
def test_a_fit_starts_from_a_file(photo, tmp_path, family):
    first = [*COMMAND, str(photo), "-n", "8", "--steps", "25", "--family", family]
    names = [str(tmp_path / name) for name in ("a.npz", "a.svg")]
    done = subprocess.run(
        [*first, "-o", names[0], "-o", names[1]], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    saved = sr.FitResult.load(names[0])
    for name in names if family == "layers" else names[:1]:
        again = [*COMMAND, str(photo), "-n", "8", "--steps", "0", "--family", family]
        done = subprocess.run(
            [*again, "--start", name, "-o", str(tmp_path / "b.npz")],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        result = sr.FitResult.load(tmp_path / "b.npz")
        np.testing.assert_allclose(result.scene.positions, saved.scene.positions, atol=1e-3)
        assert result.psnr > saved.psnr - (0.2 if family == "layers" else 1.0)
    over = subprocess.run(
        [*first, "--start", names[0], "-o", names[0]], capture_output=True, text=True, check=False
    )
    assert over.returncode == 1
    assert "that is what the fit starts from" in over.stderr


@pytest.mark.slow
def test_standard_input_and_output(photo, tmp_path):
    command = [*COMMAND, "-", "-n", "4", "--steps", "2", "--focus", "0,0,9,9"]
    done = subprocess.run(command, input=photo.read_bytes(), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    assert b"-: 4 triangles" in done.stderr
    (tmp_path / "a.svg").write_bytes(done.stdout)
    assert sr.read_svg(tmp_path / "a.svg").triangles.shape == (4, 3)


@pytest.mark.slow
def test_a_film_becomes_an_animation(photo, tmp_path):
    write_image(tmp_path / "photo2.png", np.roll(blobs(), 2, 1))
    frames = [str(photo), str(tmp_path / "photo2.png")]
    for name in ("a.svg", "a.gif"):
        film = ["fit", *frames, "-n", "5", "--steps", "4", "--frame-steps", "3", "--fps", "20"]
        done = CliRunner().invoke(app, [*film, "--animation", str(tmp_path / name)])
        assert done.exit_code == 0, done.stderr
        assert f"{name}: 2 frames, 5 triangles, mean PSNR" in done.stdout
    assert (tmp_path / "a.svg").read_text().count("<animate") >= 5
    assert (tmp_path / "a.gif").read_bytes()[:6] == b"GIF89a"


@pytest.mark.slow
def test_without_a_photo_a_bundled_picture_is_fitted(photo, tmp_path):
    command = [*COMMAND, "-n", "10", "--steps", "25", "--size", "64"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0, done.stderr
    assert sr.read_svg(tmp_path / "valley.fit.svg").triangles.shape[0] <= 10


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGINT")
def test_ctrl_c_saves_the_best_so_far(photo, tmp_path):
    output = tmp_path / "a.npz"
    command = [*COMMAND, str(photo), "-n", "8", "--steps", "100000000", "-o", str(output)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    # All steps would take hours. The first checkpoint comes half a minute after they begin.
    limit = time.monotonic() + 300
    while not output.exists():
        assert process.poll() is None and time.monotonic() < limit
        time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    output_text, errors = process.communicate(timeout=120)
    assert process.returncode == 130, errors
    assert "stopping, writing the best so far; once more to give up" in errors
    assert "interrupted" in errors
    assert "PSNR" in output_text
    result = sr.FitResult.load(output)
    assert result.interrupted
    assert np.isfinite(result.image).all()


def test_colors_of_the_options_are_those_of_fit():
    from softras2d.cli.fit_steering import parse_background, parse_freeze, parse_palette

    assert parse_palette(None) is None
    assert parse_palette("8") == 8
    assert parse_palette("#ff0000, #0000FF") == [[1, 0, 0], [0, 0, 1]]
    assert parse_background("fit") == "fit"
    assert parse_background("#00ff00") == [0, 1, 0]
    assert parse_freeze("positions, colors") == ["positions", "colors"]
