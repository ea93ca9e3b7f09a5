"""`softras2d render --tiled` writes the image of `softras2d render`."""

import numpy as np
import pytest
from typer.testing import CliRunner

import softras2d as sr
from softras2d.cli import app
from softras2d.tiled import write_tiles


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["render", *map(str, arguments)])
    return result.exit_code, result.output


@pytest.mark.slow
def test_a_tiled_image_is_that_of_one_piece(tmp_path):
    common = ("wheel", "--size", "200", "--samples", "1")
    whole, tiled = tmp_path / "whole.png", tmp_path / "tiled.tif"
    assert run(*common, "-o", whole)[0] == 0
    code, output = run(*common, "-o", tiled, "--tiled", "--tile", "128")
    assert code == 0 and "4 tiles" in output
    np.testing.assert_array_equal(sr.read_image(whole), sr.read_image(tiled))
    assert sorted(path.name for path in tmp_path.glob("*.*")) == ["tiled.tif", "whole.png"]


@pytest.mark.slow
def test_a_side_may_have_100_000_pixels(tmp_path):
    image = tmp_path / "wide.tif"
    common = ("squares", "--size", "100000x32", "--fit", "stretch", "--samples", "1")
    code, output = run(*common, "-o", image, "--tiled", "--tile", "8192")
    assert code == 0 and "100000 x 32 pixels" in output and "13 tiles" in output
    pixels = sr.read_image(image)
    assert pixels.shape[:2] == (32, 100_000) and len(np.unique(pixels[16], axis=0)) > 1


def test_contradictions_are_one_line(tmp_path):
    for arguments, message in (
        (("-o", "-", "--tiled"), "writes to a file"),
        (("-o", tmp_path / "a.png", "--tile", "64"), "--tile needs --tiled"),
        (("-o", tmp_path / "a.jpg", "--tiled"), "the suffix of a tiled image must be one of"),
        (("-o", tmp_path / "a.png", "--tiled", "--tile", "100"), "--tile must be a multiple of 32"),
        (("-o", tmp_path / "a.png", "--samples", "5"), "--samples must be one of 1, 4, 9, 16"),
        (("-o", tmp_path / "a.png", "--lod-bias", "nan"), "--lod-bias must be one finite number"),
    ):
        code, output = run("wheel", *arguments)
        assert code == 1 and message in output and len(output.strip().splitlines()) == 1


def test_errors_name_the_scene_or_the_image_file(tmp_path, monkeypatch):
    image = tmp_path / "a.png"
    for message, line in (
        ("too many triangles.", "wheel: too many triangles."),
        (f"{image}: the disk is full.", f"{image}: the disk is full."),
    ):

        def fail(*arguments, text=message, **options):
            raise ValueError(text)

        monkeypatch.setattr(write_tiles, "write_tiles", fail)
        code, output = run("wheel", "-o", image, "--tiled", "--size", "64")
        # A terminal wraps long lines, even within a path.
        text = output.replace("\n", "")
        assert code == 1 and line in text
        assert ("wheel" in text) == line.startswith("wheel")
