"""`softras2d fit`: the files it writes, the arguments it refuses, and Ctrl-C."""

import json
import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

import softras2d as sr
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
            "--softness must be pixels, or PIXELS:PIXELS; got 'wide'",
        ),
        (["PHOTO", "-o", "a.svg", "-o", "a.svg"], "given twice"),
        (["PHOTO", "-n", "0"], "`triangles` must be a whole number from 1"),
        (["PHOTO", "--steps", "5", "--seconds", "1"], "give one of --steps and --seconds"),
        (["PHOTO", "--resume", "none.npz"], "none.npz: no such file"),
        (["PHOTO", "--shading", "linear"], "`shading` of a layers fit"),
        (["PHOTO", "--start", "even"], "error, uniform, delaunay, or an .svg or .npz; got 'even'"),
        (["PHOTO", "--palette", "red"], "--palette must be a number of colours, or colours such"),
        (["PHOTO", "--palette", "8", "--shading", "gouraud"], "it needs `shading='flat'`"),
        (["PHOTO", "--background", "red"], "`background` must be one of 'mean', 'fit', 'transp"),
        (["PHOTO", "--freeze", "positions,shape"], "`freeze` must have names from 'positions'"),
        (["PHOTO", "--start", "none.svg"], "none.svg: cannot be read: No such file"),
        (["PHOTO", "--start", "a.svg", "--family", "mesh"], "or an .npz; got 'a.svg'"),
    ],
)
def test_errors_are_one_line(photo, tmp_path, arguments, message):
    from typer.testing import CliRunner

    from softras2d.cli import app

    os.chdir(tmp_path)
    done = CliRunner().invoke(
        app, ["fit", *(str(photo) if argument == "PHOTO" else argument for argument in arguments)]
    )
    assert done.exit_code == 1
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
    assert {p.name for p in tmp_path.iterdir()} <= {"photo.png", "cache"}


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
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "PSNR" in done.stdout
    assert "a browser shows the SVG by linear gradients" in done.stdout
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
    found = sr.FitResult.load(names[0])
    for name in names if family == "layers" else names[:1]:
        again = [*COMMAND, str(photo), "-n", "8", "--steps", "0", "--family", family]
        done = subprocess.run(
            [*again, "--start", name, "-o", str(tmp_path / "b.npz")],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        result = sr.FitResult.load(tmp_path / "b.npz")
        np.testing.assert_allclose(result.scene.positions, found.scene.positions, atol=1e-3)
        assert result.psnr > found.psnr - (0.2 if family == "layers" else 1.0)
    over = subprocess.run(
        [*first, "--start", names[0], "-o", names[0]], capture_output=True, text=True, check=False
    )
    assert over.returncode == 1
    assert "that is what the fit starts from" in over.stderr


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
    command = [*COMMAND, str(photo), "-n", "8", "--steps", "100000", "-o", str(output)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    # The steps would take many minutes; half a minute after they begin there is a checkpoint.
    limit = time.monotonic() + 300
    while not output.exists():
        assert process.poll() is None and time.monotonic() < limit
        time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    output_text, errors = process.communicate(timeout=120)
    assert process.returncode == 130, errors
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
