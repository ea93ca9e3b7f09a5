"""Compare how fast solvers lower the error from the same start.

python -m experiments.fit_solvers.run [--seconds 8] [--counts 50,200,1000] [--side 128]
"""

import argparse
import itertools
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

import softras2d as sr
from softras2d import pictures
from softras2d.fitting.resample import shrink
from softras2d.fitting.solvers import SOLVERS

from ..common import machine, progress, report
from . import figure

HERE = Path(__file__).parent
PACKAGES = ("softras2d", "jax", "jaxlib", "optimistix", "lineax", "optax", "numpy")
SEED = 0


ENDLESS = 100_000
"""Maximum number of steps of fits that stop when the time is up."""


def rows_of(target: np.ndarray, count: int, solver: str, seconds: float) -> list[dict[str, Any]]:
    """One row for the start and one after each chunk of steps; times exclude compilation."""
    start = sr.fit(target, triangles=count, start="uniform", seed=SEED, steps=0)
    records, compiled = _fitted(target, count, solver, seconds, ENDLESS)
    if solver == "adam":
        # The learning rate falls towards the last step, which must be reached when the time ends.
        records, compiled = _fitted(target, count, solver, np.inf, records[-1].steps)
    labels = {"triangles": count, "solver": solver}
    first = labels | {"steps": 0, "seconds": 0.0, "psnr": start.psnr}
    return [first] + [
        labels | {"steps": record.steps, "seconds": record.seconds - compiled, "psnr": record.psnr}
        for record in records
    ]


def _fitted(
    target: np.ndarray, count: int, solver: str, seconds: float, steps: int
) -> tuple[list[Any], float]:
    """Fit until `seconds` or `steps` are reached; return the records, and the compile time in s."""
    records: list[Any] = []

    def note(progress: Any) -> None:
        records.append(progress.record)
        if len(records) > 2 and _compiling(records) + seconds < records[-1].seconds:
            raise KeyboardInterrupt

    sr.fit(
        target, triangles=count, solver=solver, start="uniform", seed=SEED, steps=steps,
        report=note,
    )  # fmt: skip
    return records, _compiling(records)


def _compiling(records: list[Any]) -> float:
    """Compile time: seconds of the first chunk, minus what its steps take in later chunks."""
    if len(records) < 3:
        return records[0].seconds
    paces = [(b.seconds - a.seconds) / (b.steps - a.steps) for a, b in itertools.pairwise(records)]
    return records[0].seconds - records[0].steps * float(np.median(paces))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--counts", default="50,200,1000")
    parser.add_argument("--solvers", default=",".join(SOLVERS))
    parser.add_argument("--side", type=int, default=128)
    chosen = parser.parse_args()
    began = time.perf_counter()
    target = shrink(sr.read_image(pictures.path("fruit")), chosen.side, chosen.side)
    counts = [int(count) for count in chosen.counts.split(",")]
    work = [(count, solver) for count in counts for solver in chosen.solvers.split(",")]
    rows = []
    for count, solver in progress.steps(work, "solvers"):
        rows += rows_of(target, count, solver, chosen.seconds)
    results = HERE / "results"
    report.write_csv(results / "solvers.csv", rows)
    run = {
        "machine": machine.record(PACKAGES),
        "precision": "float32",
        "seconds": time.perf_counter() - began,
        "side": chosen.side,
    }
    (results / "run.json").write_text(json.dumps(run, indent=1) + "\n")
    figure.publish(results, HERE / "README.md")


if __name__ == "__main__":
    main()
