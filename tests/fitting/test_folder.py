"""Fits of all pictures in a folder: size classes, batches, time limits, and killed processes."""

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import softras2d as sr
from softras2d.fitting.folder import (
    find_pictures,
    fit_pictures,
    make_batches,
    shrunken,
    size_class,
)

SIZES = [(40, 64), (64, 40), (41, 66), (48, 48), (90, 57)]
"""Height and width of pictures. Shrunk to 32 pixels, they are of three size classes."""


def make_folder(folder: Path, count: int) -> Path:
    rng = np.random.default_rng(0)
    folder.mkdir()
    for k in range(count):
        height, width = SIZES[k % len(SIZES)]
        y, x = np.mgrid[:height, :width] / 40
        image = np.stack([np.sin(x * rng.uniform(1, 4) + y * c) for c in (1, 2, 3)], -1) / 2 + 0.5
        sr.write_image(folder / f"picture{k}.png", image.astype(np.float32))
    return folder


def test_size_classes_are_few_and_not_larger_than_the_picture():
    classes = set()
    for height in range(1, 400, 3):
        for width in range(1, 400, 7):
            kind = size_class(height, width, 100)
            assert kind.height <= height and kind.width <= width and max(kind) <= 100
            assert (kind.height >= kind.width) == (height >= width)
            if min(height, width) >= max(32, height / 4, width / 4):
                stretch = kind.height * width / (kind.width * height)
                assert 0.7 < stretch < 1.45
            classes.add(kind)
    assert len(classes) < 200
    assert size_class(300, 200, 100) == (100, 62)
    assert size_class(70, 65, 100) == (64, 56)


def test_batches_depend_on_the_folder_alone(tmp_path):
    folder = make_folder(tmp_path / "pictures", 7)
    (folder / "broken.png").write_bytes(b"no picture")
    # Other systems leave such files beside the pictures.
    (folder / "._picture0.png").write_bytes(b"no picture")
    (folder / "folder.png").mkdir()
    failures: list[str] = []
    batches = make_batches(find_pictures(folder), 32, 2, failures.append)
    assert len(failures) == 1 and "broken.png" in failures[0]
    assert sum(len(batch.pictures) for batch in batches) == 7
    assert [batch.number for batch in batches] == list(range(len(batches)))
    assert all(1 <= len(batch.pictures) <= 2 for batch in batches)
    seeds = [batch.first_index + k for batch in batches for k in range(len(batch.pictures))]
    assert seeds == list(range(7))
    clear = np.zeros((40, 64, 4), np.float32)
    assert (shrunken(clear, batches[0].size) == 1).all()
    (folder / "picture0.jpg").write_bytes(b"")
    with pytest.raises(ValueError, match=r"would replace those of picture0\.jpg"):
        find_pictures(folder)
    with pytest.raises(ValueError, match="no pictures"):
        find_pictures(tmp_path)


@pytest.mark.parametrize("compiles_first", [True, False])
def test_a_time_limit_counts_no_compilation(compiles_first, tmp_path, monkeypatch):
    """The first fit of a size class follows a fit of a single step, which compiles the program."""
    calls: list[dict[str, Any]] = []

    def fit(targets: list[Any], **settings: Any) -> list[Any]:
        calls.append(settings)
        return [SimpleNamespace(interrupted=settings["seconds"] is not None)]

    monkeypatch.setattr("softras2d.fitting.folder.fit_batch", fit)
    (batch, *_) = make_batches(find_pictures(make_folder(tmp_path / "p", 3)), 32, 4, pytest.fail)
    with pytest.raises(KeyboardInterrupt):
        next(
            fit_pictures(
                batch, tmp_path, count=4, seed=0, fail=pytest.fail, compiles_first=compiles_first,
                seconds=1.5, triangles=8,
            )
        )  # fmt: skip
    limits = [(call.get("steps"), call["seconds"]) for call in calls]
    assert limits == [(1, None)] * compiles_first + [(None, 1.5)]
    assert all(c["triangles"] == 8 and c["seed"] == batch.first_index for c in calls)


def start(folder: Path, output: Path, cache: Path, *options: str) -> subprocess.Popen:
    command = [sys.executable, "-m", "softras2d", "fit-batch", str(folder), "-o", str(output)]
    command += ["-n", "8", "--steps", "20", "--size", "32", "--batch", "4", *options]
    environment = os.environ | {"XDG_CACHE_HOME": str(cache), "JAX_PLATFORMS": "cpu"}
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )


def finish(process: subprocess.Popen) -> str:
    stdout, stderr = process.communicate(timeout=400)
    assert process.returncode == 0, stderr.decode()
    return stdout.decode()


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGKILL")
def test_processes_and_a_killed_one_write_the_files_of_one_process(tmp_path):
    """A process that is killed after some of sixteen pictures has written these completely."""
    folder, cache = make_folder(tmp_path / "pictures", 16), tmp_path / "cache"
    killed = tmp_path / "killed"
    process = start(folder, killed, cache)
    # Drafts, which are renamed when they are complete, begin with a dot.
    while process.poll() is None and not list(killed.glob("[!.]*.json")):
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    written = {n: c for n, c in contents(killed).items() if not n.startswith(".")}
    done = [name for name in written if name.endswith(".json")]
    assert 0 < len(done) < 16
    times = {name: (killed / name).stat().st_mtime_ns for name in done}
    assert f"{len(done)} were done before" in finish(start(folder, killed, cache))
    assert all((killed / name).stat().st_mtime_ns == times[name] for name in done)
    expected = contents(killed)
    assert len(expected) == 32 and written.items() <= expected.items()

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    shared = tmp_path / "shared"
    processes = [
        start(folder, shared, cache, "--coordinator", f"127.0.0.1:{port}",
              "--processes", "2", "--process", str(k))
        for k in range(2)
    ]  # fmt: skip
    for each in processes:
        finish(each)
    assert contents(shared) == expected
