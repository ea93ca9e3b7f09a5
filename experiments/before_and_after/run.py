"""Time two checkouts of softras2d against each other, in turn, on the same arrays.

Each row of the table is timed in one process per checkout. The calls of the two processes
alternate, so that drift of the machine affects both equally.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..common import machine, report, scenes

HERE = Path(__file__).parent
RESULTS = HERE / "results"
ROOT = HERE.parents[1]


class Row(NamedTuple):
    """A row of the table: a scene, a coverage mode, and a call for the image or the gradient."""

    name: str
    kind: str
    coverage: str
    what: str
    count: int = 1000
    size: int = 512


ROWS = (
    Row("flat, alpha 0.5: image", "flat_a50", "hard", "image"),
    Row("flat, alpha 0.5: gradient", "flat_a50", "hard", "gradient"),
    Row("corner colours, alpha 0.5: image", "gouraud_a50", "hard", "image"),
    Row("corner colours, alpha 0.5: gradient", "gouraud_a50", "hard", "gradient"),
    Row("overdraw 100, alpha 0.5, 256 px: image", "overdraw_a50", "hard", "image", size=256),
    Row("overdraw 100, alpha 0.5, 256 px: gradient", "overdraw_a50", "hard", "gradient", size=256),
    Row("174 textured images, trilinear: image", "minified", "hard", "image"),
    Row("174 textured images, trilinear: gradient", "minified", "hard", "gradient"),
    Row("corner colours, `Soft`: image", "gouraud", "soft", "image"),
    Row("corner colours, `Area`: image", "gouraud", "area", "image"),
    Row("corner colours, `Soft`: gradient", "gouraud", "soft", "gradient"),
    Row("corner colours, `Area`: gradient", "gouraud", "area", "gradient"),
    Row("flat, `Hard`: image", "flat", "hard", "image"),
    Row("flat, `Hard`: gradient", "flat", "hard", "gradient"),
    Row("flat, `Soft`: gradient", "flat", "soft", "gradient"),
    Row("flat, `Area`: gradient", "flat", "area", "gradient"),
    Row("flat, 100 triangles: image", "flat", "hard", "image", 100),
    Row("flat, 10,000 triangles: image", "flat", "hard", "image", 10_000),
)
"""1,000 triangles on 512 x 512 px unless the name says otherwise; `Hard` has 16 samples."""

_CALLS, _SECONDS = 15, 12.0
"""Timed calls of each checkout, and a limit, in seconds, on the time of both together."""

_OVERDRAW_SCALE = 20**0.5
"""Factor that enlarges triangles about their centres, so that 100 instead of 5 cover a pixel."""


def main() -> None:
    """Write `results/times.json`, and fill the table of the README."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("before", type=Path, help="Root of the other checkout.")
    parser.add_argument(
        "--only", nargs="*", help="Time only rows whose names contain one of these words."
    )
    arguments = parser.parse_args()
    rows = [row for row in ROWS if _is_wanted(row, arguments.only)]
    measured = []
    with tempfile.TemporaryDirectory() as folder:
        arrays = Path(folder) / "scenes.npz"
        _write_scenes(arrays, rows)
        for row in rows:
            measured.append({"name": row.name, **_measure(row, arguments.before, arrays)})
            print(measured[-1], flush=True)
    result = {
        "machine": machine.record(["jax", "jaxlib", "equinox", "numpy"]),
        "precision": "float32",
        "before": _commit(arguments.before),
        "after": _commit(ROOT),
        "rows": measured,
    }
    if arguments.only:
        print(table(result))
        return
    report.write_json(RESULTS / "times.json", result)
    texts = {
        "table": table(result),
        "machine": f"{machine.describe(result, seed='seed 0')}; commits {result['before']} and "
        f"{result['after']}.",
    }
    report.fill_or_print(HERE / "README.md", texts)


def _is_wanted(row: Row, words: list[str] | None) -> bool:
    return not words or any(word in row.name for word in words)


def _write_scenes(path: Path, rows: list[Row]) -> None:
    """Write the arrays of all random scenes, so that both checkouts draw the same ones."""
    arrays = {}
    for row in rows:
        if row.kind == "minified":
            continue
        kind = row.kind.replace("overdraw", "flat")
        soup = scenes.random_soup(row.count, row.size, kind)
        corners = soup.corners
        if row.kind.startswith("overdraw"):
            middle = corners.mean(axis=1, keepdims=True)
            corners = (middle + _OVERDRAW_SCALE * (corners - middle)).astype(np.float32)
        colors = soup.colors[:, 0] if soup.flat else soup.colors
        name = f"{row.kind}_{row.count}_{row.size}"
        arrays[f"{name}_corners"] = corners
        arrays[f"{name}_colors"] = colors[..., :3] if soup.opaque else colors
    np.savez(path, **arrays)


def _measure(row: Row, before: Path, arrays: Path) -> dict[str, Any]:
    """Time one row with both checkouts.

    Returns, for each, the medians of wall-clock and processor time in milliseconds, the seconds of
    the first call, and the MiB by which its process grew.
    """
    prepare = f"prepare {row.kind} {row.count} {row.size} {row.coverage} {row.what}"
    with _worker(before, arrays) as old, _worker(ROOT, arrays) as new:
        first = [_ask(worker, prepare) for worker in (old, new)]
        times: list[list[dict[str, float]]] = [[], []]
        spent = 0.0
        while len(times[0]) < _CALLS and (spent < _SECONDS or len(times[0]) < 5):
            for worker, answers in zip((old, new), times, strict=True):
                # An untimed call first, because the other process has filled the caches.
                _ask(worker, "call")
                answers.append(_ask(worker, "call"))
                spent += 2e-3 * answers[-1]["wall_ms"]
    result: dict[str, Any] = {}
    for label, opening, answers in zip(("before", "after"), first, times, strict=True):
        for key in ("wall_ms", "processor_ms"):
            result[f"{label}_{key}"] = round(statistics.median(a[key] for a in answers), 2)
        result[f"{label}_first_s"] = round(opening["first_s"], 2)
        result[f"{label}_mib"] = round(opening["peak_mib"] - opening["before_mib"])
    return result


@contextmanager
def _worker(checkout: Path, arrays: Path) -> Iterator["subprocess.Popen[str]"]:
    """Start a process that runs `work.py` with the package of a checkout; end it afterwards."""
    environment = os.environ | {"PYTHONPATH": str(checkout.resolve())}
    command = [sys.executable, str(HERE / "work.py"), str(arrays)]
    worker = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment
    )
    try:
        yield worker
    finally:
        worker.kill()
        worker.wait()


def _ask(worker: "subprocess.Popen[str]", command: str) -> dict[str, float]:
    assert worker.stdin is not None and worker.stdout is not None
    worker.stdin.write(f"{command}\n")
    worker.stdin.flush()
    answer = worker.stdout.readline()
    if not answer:
        raise RuntimeError(f"the process ended: {command}")
    return json.loads(answer)


def _commit(checkout: Path) -> str:
    command = ["git", "-C", str(checkout), "rev-parse", "--short", "HEAD"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def table(result: dict[str, Any]) -> str:
    """The rows as a Markdown table."""
    header = ["scene and call", "before, ms", "after, ms", "after / before",
              "processor time, after / before", "first call, s", "memory, MiB"]  # fmt: skip
    rows = [
        [
            row["name"],
            f"{row['before_wall_ms']:.1f}",
            f"{row['after_wall_ms']:.1f}",
            f"{row['after_wall_ms'] / row['before_wall_ms']:.2f}",
            f"{row['after_processor_ms'] / row['before_processor_ms']:.2f}",
            f"{row['before_first_s']:.1f} -> {row['after_first_s']:.1f}",
            f"{row['before_mib']} -> {row['after_mib']}",
        ]
        for row in result["rows"]
    ]
    return report.table(header, rows)


if __name__ == "__main__":
    main()
