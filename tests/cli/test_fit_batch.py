"""`softras2d fit-batch`: the arguments it refuses, and the processes it joins."""

import json
from pathlib import Path
from typing import Any

import jax
import pytest
from typer.testing import CliRunner

from softras2d.cli import app
from softras2d.io.images import write_image

from ..cases.pictures import blobs

FIRST_OF_TWO = ["--processes", "2", "--process", "0"]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "photos"
    path.mkdir()
    write_image(path / "photo.png", blobs(8, 8))
    return path


@pytest.fixture
def cluster(monkeypatch) -> list[Any]:
    """Record the calls that would join and leave other processes, instead of waiting for them."""
    calls: list[Any] = []
    monkeypatch.setattr(jax.distributed, "initialize", lambda *given: calls.append(given))
    monkeypatch.setattr(jax.distributed, "shutdown", lambda: calls.append("left"))
    return calls


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--steps", "5", "--seconds", "1"], "give one of --steps and --seconds"),
        (["--seconds", "0"], "--seconds must be a number above 0; got 0.0"),
        (["--steps", "-1"], "--steps must be an integer in 0..2147483647; got -1"),
        (["--processes", "2"], "--processes and --process need --coordinator"),
        (["--coordinator", "host0:80"], "--coordinator needs --processes and --process"),
        (
            ["--coordinator", "host0:80", "--processes", "2", "--process", "2"],
            "--process must be in 0..1; got 2",
        ),
        (["--coordinator", "host0", *FIRST_OF_TWO], "must be HOST:PORT, or auto; got host0."),
        (["--coordinator", "host0:p", *FIRST_OF_TWO], "must be HOST:PORT, or auto; got host0:p."),
        (["--coordinator", ":80", *FIRST_OF_TWO], "must be HOST:PORT, or auto; got :80."),
        (["--coordinator", "host0:0", *FIRST_OF_TWO], "must be HOST:PORT, or auto; got host0:0."),
        (["--coordinator", "h:65536", *FIRST_OF_TWO], "must be HOST:PORT, or auto; got h:65536."),
    ],
)
def test_errors_are_one_line(folder, cluster, arguments: list[str], message: str):
    done = CliRunner().invoke(app, ["fit-batch", str(folder), "-o", "out", *arguments])
    assert done.exit_code == 1
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
    assert not cluster


def run(folder, *arguments: str) -> str:
    """Fit a folder, which must succeed, and return what is printed on standard error."""
    done = CliRunner().invoke(app, ["fit-batch", str(folder), "-o", "out", *arguments])
    assert done.exit_code == 0, done.stderr
    return done.stderr


def test_finished_pictures_of_other_settings_are_named(folder):
    settings = ["-n", "3", "--steps", "1", "--size", "8"]
    assert run(folder, *settings) == run(folder, *settings) == ""
    assert run(folder, "-n", "3", "--steps", "2", "--size", "8", "--solver", "lm") == (
        "warning: out: 1 finished picture is kept, fitted with other values of --solver, --steps; "
        "to fit again, remove NAME.json, or choose another --output\n"
    )
    # A report of an older version has the number of triangles, but no settings.
    report = json.loads(Path("out/photo.json").read_text())
    del report["settings"]
    Path("out/photo.json").write_text(json.dumps(report))
    assert run(folder, "-n", "3", "--steps", "2", "--size", "8") == ""
    assert "fitted with other values of -n;" in run(folder, "-n", "4")


def test_processes_leave_each_other_before_they_fit(folder, cluster):
    """JAX would abort all processes after one is killed, or has finished long before the others."""
    (folder / "photo.png").rename(folder / "photo.txt")
    arguments = ["--coordinator", "host0:80", *FIRST_OF_TWO]
    done = CliRunner().invoke(app, ["fit-batch", str(folder), "-o", "out", *arguments])
    assert cluster == [("host0:80", 2, 0), "left"]
    assert "waiting for 2 processes at host0:80\n" in done.stderr
    assert "no pictures in this folder" in done.stderr
