"""Which solver lowers the error fastest, from one start?

python -m experiments.fit_solvers.run [--seconds 8] [--counts 50,200,1000] [--side 128]
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

import softras2d as sr
from softras2d import pictures
from softras2d.fit.resample import shrink
from softras2d.fit.solvers import SOLVERS

from ..common import machine, progress, report
from . import figure

HERE = Path(__file__).parent
PACKAGES = ("softras2d", "jax", "jaxlib", "optimistix", "lineax", "optax", "numpy")
SEED = 0


def rows_of(target: np.ndarray, count: int, solver: str, seconds: float) -> list[dict[str, Any]]:
    """The error after each chunk of steps, and what steps take: compilation is not among it."""
    moments = []
    began = [0.0]

    def note(moment: Any) -> None:
        record = moment.record
        if not moments:
            began[0] = record.seconds
        moments.append(record)
        if record.seconds - began[0] >= seconds:
            raise KeyboardInterrupt

    sr.fit(
        target, triangles=count, solver=solver, start="uniform", seed=SEED, steps=100_000,
        report=note,
    )  # fmt: skip
    return [
        {
            "triangles": count,
            "solver": solver,
            "steps": record.steps,
            "seconds": record.seconds - began[0],
            "psnr": record.psnr,
        }
        for record in moments
    ]


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
