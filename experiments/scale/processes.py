"""Compare fits of a folder by one process and by several: `python -m experiments.scale.processes`.

Sixteen crops of the bundled pictures are fitted by `softras2d fit-batch` in one, two and four
processes on this machine, which communicate by `jax.distributed`.
"""

import json
import os
import socket
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import softras2d as sr

from ..common import report

HERE = Path(__file__).parent
PROCESSES = (1, 2, 4)
CROP = 96
"""Side of a picture, in pixels."""

STEPS = 60
SECONDS = 60.0
"""Time limit of a batch, in seconds, for a process that does not share its core."""

CORES = sorted(os.sched_getaffinity(0))[:2]
"""The cores that are used, even if the machine has more."""


def write_crops(folder: Path) -> None:
    """Write eight crops of each bundled picture."""
    folder.mkdir()
    for name in ("valley", "fruit"):
        image = sr.read_image(Path(sr.__file__).parent / "pictures" / f"{name}.png")
        height, width = image.shape[:2]
        for k in range(8):
            top = (height - CROP) * (k // 4)
            left = (width - CROP) * (k % 4) // 3
            sr.write_image(folder / f"{name}{k}.png", image[top : top + CROP, left : left + CROP])


def fit(pictures: Path, output: Path, processes: int, budget: Sequence[str]) -> None:
    """Fit the folder in several processes at once, each bound to one of the cores."""
    command = [sys.executable, "-m", "softras2d", "fit-batch", str(pictures), "-o", str(output)]
    command += ["-n", "60", "--size", str(CROP), "--batch", "4", *budget]
    if processes > 1:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            address = f"127.0.0.1:{free.getsockname()[1]}"
        command += ["--coordinator", address, "--processes", str(processes), "--process"]
    running = []
    for k in range(processes):
        number = [str(k)] if processes > 1 else []
        started = subprocess.Popen([*command, *number], stdout=subprocess.DEVNULL)
        os.sched_setaffinity(started.pid, {CORES[k % len(CORES)]})
        running.append(started)
    for each in running:
        if each.wait():
            raise SystemExit(f"{processes} processes: one process failed.")


def scores(folder: Path) -> dict[str, float]:
    """The PSNR of every picture, in dB."""
    reports = (json.loads(path.read_text()) for path in sorted(folder.glob("*.json")))
    return {entry["picture"]: entry["psnr"] for entry in reports}


def compare(folder: Path, processes: int, expected_files: dict[str, bytes]) -> list[str]:
    """A row of the table; `expected_files` is filled in by the run of one process."""
    by_steps, by_seconds = folder / f"steps{processes}", folder / f"seconds{processes}"
    fit(folder / "pictures", by_steps, processes, ["--steps", str(STEPS)])
    files = {path.name: path.read_bytes() for path in by_steps.iterdir()}
    expected_files.update(files if processes == 1 else {})
    differing = sum(files.get(name) != content for name, content in expected_files.items())
    # Processes that share a core run longer, so that each gets as much processor time.
    seconds = SECONDS * max(1, processes // len(CORES))
    fit(folder / "pictures", by_seconds, processes, ["--seconds", str(seconds)])
    psnr, first = scores(by_seconds), scores(folder / "seconds1")
    apart = max(abs(psnr[name] - first[name]) for name in first)
    mean = sum(psnr.values()) / len(psnr)
    mean_apart = abs(mean - sum(first.values()) / len(first))
    row = [str(processes), f"{len(files)}, {differing} differ", f"{seconds:.0f}", f"{mean:.2f}"]
    return [*row, f"{mean_apart:.2f}", f"{apart:.2f}"]


def main() -> None:
    rows: list[list[str]] = []
    expected_files: dict[str, bytes] = {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_crops(folder / "pictures")
        for processes in PROCESSES:
            rows.append(compare(folder, processes, expected_files))
            print(rows[-1], flush=True)
    header = [
        "processes", "files with `--steps`", "`--seconds` per batch", "mean PSNR, dB",
        "difference of means, dB", "largest difference of a picture, dB",
    ]  # fmt: skip
    report.fill_markers(HERE / "README.md", "processes", report.table(header, rows))


if __name__ == "__main__":
    main()
