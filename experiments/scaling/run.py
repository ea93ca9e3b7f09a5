"""Measure how time and memory grow, and what traversal costs; see the README in this folder.

python -m experiments.scaling.run [--quick] [--only AXIS,AXIS] [--parts growth,memory,traversal]
"""

import argparse
import time
from pathlib import Path
from typing import Any

from ..common import machine, progress, report
from . import figure, growth, memory, visits
from .cases import AXES, QUICK, Axis, Case

HERE = Path(__file__).parent
PACKAGES = ("softras2d", "jax", "jaxlib", "numpy", "numba", "matplotlib")
PARTS = ("growth", "memory", "traversal")
MEMORY_CASES = (
    ("image", Case()),
    ("gradient", Case()),
    ("gradient", Case(triangles=100_000)),
    ("image", Case(size_px=4096)),
    ("gradient", Case(size_px=2048)),
    ("gradient", Case(samples=256)),
    ("gradient", Case(triangles=100, size_px=128, batch=64)),
)
"""Cases that are also drawn in separate processes, to measure memory."""
QUICK_MEMORY_CASES = (("gradient", Case(size_px=256)),)


def growth_rows(axes: tuple[Axis, ...], path: Path, budget_s: float) -> list[dict[str, Any]]:
    """Rows of all axes, written after each, so that results remain if the run is interrupted."""
    known: dict[Case, list[dict[str, Any]]] = {}
    rows: list[dict[str, Any]] = []
    for axis in axes:
        began = time.perf_counter()
        rows += growth.measure_axis(axis, known, budget_s)
        report.write_csv(path, rows)
        print(f"{time.perf_counter() - began:5.0f} s  {axis.name}", flush=True)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--quick", action="store_true", help="Run small sizes; results go to cache/quick."
    )
    parser.add_argument(
        "--only", default="", help="Axes, separated by commas; results go to cache/part."
    )
    parser.add_argument(
        "--parts",
        default=",".join(PARTS),
        help="Parts, separated by commas; results go to cache/part.",
    )
    options = parser.parse_args()
    only = {name for name in options.only.split(",") if name}
    parts = [part for part in PARTS if part in options.parts.split(",")]
    axes = tuple(one for one in (QUICK if options.quick else AXES) if not only or one.name in only)
    partial = options.quick or bool(only) or parts != list(PARTS)
    results = HERE / "results"
    if partial:
        results = HERE / "cache" / ("quick" if options.quick else "part")

    began = time.perf_counter()
    if "growth" in parts:
        growth_rows(axes, results / "growth.csv", budget_s=0.5 if options.quick else 3.0)
    if "memory" in parts:
        cases = QUICK_MEMORY_CASES if options.quick else MEMORY_CASES
        memory_rows = [memory.measure(*case) for case in progress.steps(cases, "memory")]
        report.write_csv(results / "memory.csv", memory_rows)
    if "traversal" in parts:
        rows: list[dict[str, Any]] = []
        for name, soup in visits.scenes(options.quick):
            rows += visits.compare(name, soup, budget_s=2.0 if options.quick else 20.0)
        report.write_csv(results / "traversal.csv", rows)
    run = {
        "machine": machine.record(PACKAGES),
        "seed": "seeds from 0, one a scene",
        "precision": "float32",
        "most_bytes": growth.MOST_BYTES,
        "most_call_s": growth.MOST_CALL_S,
        "quick": options.quick,
        "seconds": round(time.perf_counter() - began),
    }
    report.write_json(results / "run.json", run)
    if all((results / f"{part}.csv").exists() for part in PARTS):
        figure.publish(results, None if partial else HERE / "README.md")


if __name__ == "__main__":
    main()
