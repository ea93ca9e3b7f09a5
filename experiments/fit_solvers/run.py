"""Compare how fast solvers lower the error from the same start.

python -m experiments.fit_solvers.run [--seconds 8] [--counts 50,200,1000] [--side 128]
    [--mesh 1000] [--mesh-side 256]
"""

import argparse
import itertools
import json
import time
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

import softras2d as sr
from softras2d import pictures
from softras2d.comparison.similarity import psnr
from softras2d.fitting.mesh.colors import solve_colors
from softras2d.fitting.mesh.gauss_newton import gauss_newton
from softras2d.fitting.mesh.start import error_start
from softras2d.fitting.mesh.triangulation import Mesh
from softras2d.fitting.resample import shrink
from softras2d.fitting.solvers import SOLVERS
from softras2d.fitting.target import Target

from ..common import machine, progress, report
from . import figure

HERE = Path(__file__).parent
PACKAGES = ("softras2d", "jax", "jaxlib", "optimistix", "lineax", "optax", "numpy")
SEED = 0

STRUCTURED = "structured"
"""Name of the Gauss-Newton method for meshes (`fitting/mesh/gauss_newton.py`) in the results."""

STRUCTURED_STEPS = (1, 2, 3, 5, 8, 12, 20, 30, 45, 70, 100, 150, 220, 330, 500)
"""Numbers of steps after which the image of the structured method is scored."""

ENDLESS = 100_000
"""Maximum number of steps of fits that stop when the time is up."""


class Subject(NamedTuple):
    """What all solvers start from.

    - `name`: title of the panel in the figure.
    - `target`: the image to be fitted.
    - `options`: arguments of `fit`; its triangles are never exchanged.
    """

    name: str
    target: np.ndarray
    options: dict[str, Any]


def layers(side: int, count: int) -> Subject:
    """Flat layers, placed at random over a picture of `side` x `side` pixels."""
    options = {"triangles": count, "start": "uniform", "seed": SEED}
    return Subject(f"{count:,} layers", _picture(side), options)


def mesh(side: int, count: int) -> Subject:
    """A mesh of about `count` triangles whose vertices were inserted greedily."""
    target = _picture(side)
    start = error_start(Target(target), count // 2 + 3, seed=SEED, exchanges=0)
    options = {"family": "mesh", "triangles": count, "start": start, "seed": SEED}
    return Subject(f"mesh of {count:,}", target, options)


def _picture(side: int) -> np.ndarray:
    return shrink(sr.read_image(pictures.path("fruit")), side, side)


def rows_of(subject: Subject, solver: str, seconds: float) -> list[dict[str, Any]]:
    """One row for the start and one after each chunk of steps; times exclude compilation."""
    labels = {"subject": subject.name, "solver": solver}
    if solver == STRUCTURED:
        return [labels | row for row in _structured(subject, seconds)]
    start = sr.fit(subject.target, steps=0, **subject.options)
    records, compiled = _fitted(subject, solver, seconds, ENDLESS)
    if solver == "adam":
        # The learning rate falls towards the last step, which must be reached when the time ends.
        records, compiled = _fitted(subject, solver, np.inf, records[-1].steps)
    first = labels | {"steps": 0, "seconds": 0.0, "psnr": start.psnr}
    return [first] + [
        labels | {"steps": record.steps, "seconds": record.seconds - compiled, "psnr": record.psnr}
        for record in records
    ]


def _structured(subject: Subject, seconds: float) -> list[dict[str, Any]]:
    """One row for the start and one after several numbers of steps; times exclude scoring.

    It ends when no further step lowers the error, or before a run that exceeds the time.
    """
    start, target = subject.options["start"], Target(subject.target)
    colors = np.clip(solve_colors(start, target), 0, 1)
    rows = [{"steps": 0, "seconds": 0.0, "psnr": _mesh_psnr(start, colors, subject.target)}]
    for steps in STRUCTURED_STEPS:
        began = time.perf_counter()
        moved = gauss_newton(start, target, colors, steps)
        elapsed = time.perf_counter() - began
        if elapsed > seconds:
            break
        psnr_of_mesh = _mesh_psnr(moved.mesh, moved.colors, subject.target)
        rows.append({"steps": moved.steps, "seconds": elapsed, "psnr": psnr_of_mesh})
        if moved.steps < steps:
            break
    return rows


def _mesh_psnr(mesh: Mesh, colors: np.ndarray, target: np.ndarray) -> float:
    """PSNR, in dB, of the exact image of a mesh."""
    height, width = target.shape[:2]
    scene = sr.Scene.from_mesh(
        jnp.asarray(mesh.positions, jnp.float32),
        mesh.triangles,
        triangle_colors=colors[mesh.triangles],
    )
    plan = sr.plan(scene, height=height, width=width, coverage=sr.Area("sum"))
    return float(psnr(sr.render(scene, plan), target))


def _fitted(subject: Subject, solver: str, seconds: float, steps: int) -> tuple[list[Any], float]:
    """Fit until `seconds` or `steps` are reached; return the records, and the compile time in s."""
    records: list[Any] = []

    def note(progress: Any) -> None:
        records.append(progress.record)
        if len(records) > 2 and _compiling(records) + seconds < records[-1].seconds:
            raise KeyboardInterrupt

    sr.fit(subject.target, solver=solver, steps=steps, report=note, **subject.options)
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
    parser.add_argument("--mesh", type=int, default=1000, help="Triangles; 0: no mesh.")
    parser.add_argument("--mesh-side", type=int, default=256)
    chosen = parser.parse_args()
    began = time.perf_counter()
    solvers = chosen.solvers.split(",")
    subjects = [layers(chosen.side, int(count)) for count in chosen.counts.split(",")]
    work = [(subject, solver) for subject in subjects for solver in solvers]
    if chosen.mesh:
        tiling = mesh(chosen.mesh_side, chosen.mesh)
        work += [(tiling, solver) for solver in (*solvers, STRUCTURED)]
    rows = []
    for subject, solver in progress.steps(work, "solvers"):
        rows += rows_of(subject, solver, chosen.seconds)
    results = HERE / "results"
    report.write_csv(results / "solvers.csv", rows)
    run = {
        "machine": machine.record(PACKAGES),
        "precision": "float32",
        "seconds": time.perf_counter() - began,
        "arguments": vars(chosen),
    }
    (results / "run.json").write_text(json.dumps(run, indent=1) + "\n")
    figure.publish(results, HERE / "README.md")


if __name__ == "__main__":
    main()
