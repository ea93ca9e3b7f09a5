"""`softras2d fit --compare-in` compares the SVG in a browser with the image, or is refused."""

import re
import tempfile
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import softras2d as sr
from softras2d.cli import app
from softras2d.cli.fit_browser import browser_line
from softras2d.cli.fit_options import PictureOptions
from softras2d.io.images import write_image

from ..cases.browser import fake_browser, require_browser
from ..cases.pictures import blobs

LINE = re.compile(
    r"in (?P<browser>\S+), compared with the fit at 16 samples per pixel: mean difference "
    r"(?P<mean>\S+) levels of 255, largest (?P<largest>\d+); (?P<share>\S+) % of pixels differ by "
    r"more than 24 levels; PSNR (?P<psnr>\S+) dB"
)


def options(outputs: list[Path], browser: str) -> PictureOptions:
    return PictureOptions(
        target=None, outputs=outputs, digits=1, compare_in=browser, weights=None, focus=(),
        start="error", resume=None, watch=False, browser=False,
    )  # fmt: skip


def result() -> sr.FitResult:
    """A fit of one black triangle outside a canvas of 12 x 8 pixels, so that its image is white."""
    scene = sr.Scene.from_soup(np.full((1, 3, 2), 50.0), np.zeros((1, 3)))
    return sr.FitResult(scene, np.ones((8, 12, 3), np.float32), 20.0, 0.5, (), {})


@pytest.mark.parametrize("output", ["a.svg", "a.SVG", "-"])
def test_the_line_compares_the_svg_with_the_image_of_the_fit(tmp_path, monkeypatch, output):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    shown = np.full((8, 12, 3), 204 / 255, np.float32)
    write_image(tmp_path / "shown.png", shown)
    # The script shows a picture only if it is given the SVG.
    script = f"grep -q '<svg' ${{picture%/*}}/scene.svg && cp {tmp_path / 'shown.png'} $picture"
    browser = fake_browser(tmp_path, script)
    path = Path("-") if output == "-" else tmp_path / output
    if output != "-":
        sr.write_svg(path.with_suffix(".svg"), result().scene, height=8, width=12)
        path.with_suffix(".svg").rename(path)
    line = browser_line(options([tmp_path / "a.png", path], browser), result())
    assert line == (
        f"{path} in fake-browser, compared with the fit at 16 samples per pixel: mean difference "
        "51.00 levels of 255, largest 51; 100 % of pixels differ by more than 24 levels; PSNR "
        "13.98 dB"
    )
    left = {entry.name for entry in tmp_path.iterdir()}
    assert left <= {"shown.png", "fake-browser", output, "cache"}


def invoke(*arguments: object):
    return CliRunner().invoke(app, ["fit", *map(str, arguments)])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-o", "a.png"], "--compare-in is for SVG files; got no SVG to write, but a.png."),
        ([], "none of chromium, chromium-browser, google-chrome is installed."),
        (["--animation", "a.svg"], "--compare-in: not available for films (--animation)."),
    ],
)
def test_what_cannot_be_compared_is_refused_before_the_fit(
    tmp_path, monkeypatch, arguments, message
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))
    write_image("photo.png", blobs(8, 8))
    done = invoke("photo.png", "--compare-in", "chromium", *arguments)
    assert done.exit_code == 1
    assert message in done.stderr and done.stderr.count("\n") == 1
    assert {path.name for path in tmp_path.iterdir()} <= {"photo.png", "cache"}


def test_an_unknown_browser_is_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("no-such-browser", "./no-such-browser"):
        done = invoke("--compare-in", name)
        assert done.exit_code == 1
        assert done.stderr == f"error: --compare-in {name}: no such command or program.\n"


@pytest.mark.slow
def test_a_browser_that_fails_leaves_the_files(tmp_path):
    write_image(tmp_path / "photo.png", blobs())
    browser = fake_browser(tmp_path, "echo no display; exit 3")
    path = tmp_path / "a.svg"
    done = invoke(
        tmp_path / "photo.png", "-n", 4, "--steps", 2, "-o", path, "--compare-in", browser
    )
    assert done.exit_code == 1
    assert done.stdout.startswith(f"{path}: 4 triangles, PSNR ")
    assert done.stderr == (
        f"error: {browser} made no picture of {path}: it ended with exit code 3: no display\n"
    )
    assert sr.read_svg(path).triangles.shape == (4, 3)


@pytest.mark.slow
def test_a_real_browser_shows_nearly_the_image_of_the_fit(tmp_path):
    browser = require_browser()
    write_image(tmp_path / "photo.png", blobs(96, 128))
    fit = [tmp_path / "photo.png", "-n", 20, "--steps", 40, "-o", tmp_path / "a.svg"]
    done = invoke(*fit, "-o", tmp_path / "a.npz", "--compare-in", browser)
    assert done.exit_code == 0, done.stderr
    summary, line = done.stdout.splitlines()
    assert "20 triangles, PSNR" in summary
    assert line.startswith(f"{tmp_path / 'a.svg'} in ")
    measured = LINE.search(line)
    assert measured is not None
    assert float(measured["mean"]) < 0.5
    assert float(measured["share"]) < 1
    assert float(measured["psnr"]) > 40
    # Coordinates rounded to whole pixels make the difference larger.
    again = [tmp_path / "photo.png", "--resume", tmp_path / "a.npz", "--steps", 40, "--digits", 0]
    done = invoke(*again, "-o", tmp_path / "b.svg", "--compare-in", browser)
    assert done.exit_code == 0, done.stderr
    rounded = LINE.search(done.stdout)
    assert rounded is not None
    assert float(rounded["psnr"]) < float(measured["psnr"]) - 3
