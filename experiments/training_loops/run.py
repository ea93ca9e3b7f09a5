"""Measure training loops whose triangles move, and batches; see the README in this folder.

python -m experiments.training_loops.run [--quick] [--parts lasting,ways,batches]
"""

import argparse
import json
import time
from pathlib import Path

from ..common import machine, progress, report
from . import batches, lasting, motion, tables
from .compilations import Compilations

HERE = Path(__file__).parent
PACKAGES = ("softras2d", "jax", "jaxlib", "equinox", "optax", "numpy")
PARTS = ("lasting", "ways", "batches")
STEPS, QUICK_STEPS = 2000, 100


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--quick",
        action="store_true",
        help="Take few steps, on small scenes; results go to cache/.",
    )
    parser.add_argument(
        "--parts", default=",".join(PARTS), help="Parts of the run, separated by commas."
    )
    options = parser.parse_args()
    parts = options.parts.split(",")
    results = HERE / "cache" if options.quick else HERE / "results"
    kinds = list(batches.KINDS)[: 1 if options.quick else None]
    budget_s = 2.0 if options.quick else 20.0

    began = time.perf_counter()
    path = results / "run.json"
    run = json.loads(path.read_text()) if path.exists() else {}
    if "lasting" in parts:
        steps = QUICK_STEPS if options.quick else STEPS
        run["lasting"] = lasting.measure(steps, Compilations())
    if "ways" in parts:
        rows = [
            row for k in progress.steps(kinds, "ways") for row in batches.compare_ways(k, budget_s)
        ]
        report.write_csv(results / "ways.csv", rows)
    if "batches" in parts:
        rows = [row for k in progress.steps(kinds, "batches") for row in batches.grow(k, budget_s)]
        report.write_csv(results / "batches.csv", rows)
    run |= {
        "machine": machine.record(PACKAGES),
        "seed": motion.SEED,
        "precision": "float32",
        "quick": options.quick,
        "seconds": round(time.perf_counter() - began),
    }
    report.write_json(path, run)
    tables.publish(results, None if options.quick else HERE / "README.md")


if __name__ == "__main__":
    main()
