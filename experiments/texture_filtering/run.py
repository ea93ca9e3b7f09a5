"""Measure the error, moire, time and bytes of texture filters; see the README in this folder.

python -m experiments.texture_filtering.run [--quick] [--resume]
"""

import argparse
import functools
import pickle
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import softras2d as sr

from ..common import machine, report
from ..common.references import cache_programs
from ..common.timing import interleave
from . import pictures, probes_or_ewa, subjects, tables
from .measures import moire, rmse
from .methods import YARDSTICK, Method, methods
from .programs import Program

HERE = Path(__file__).parent
CACHE = HERE / "cache"
PACKAGES = ("softras2d", "jax", "jaxlib", "numpy", "numba", "matplotlib")
SEED = 0
TIMED = ("stretched", subjects.GROUND)
"""Scenes that are timed: an affine one and one in perspective."""
MOST_TEXELS = 512
"""Methods that read more texels per pixel are not timed: 16 probes at 16 samples read 2,048."""


class Run:
    """The results of a run so far."""

    def __init__(self, quick: bool):
        self.methods = list(methods(quick))
        self.began = time.time()
        self.measured: set[str] = set()
        self.references: dict[str, np.ndarray] = {}
        self.images: dict[tuple[str, Method], np.ndarray] = {}
        self.rows: list[dict[str, Any]] = []
        self.compared: list[dict[str, Any]] = []

    def say(self, what: str) -> None:
        print(f"{time.time() - self.began:5.0f} s  {what}", flush=True)

    def measure(self, scenes: dict[str, sr.Scene], names: Sequence[str]) -> None:
        """Make all measurements of scenes that have one structure."""
        for name in names:
            self.references[name] = subjects.reference(scenes[name], CACHE / "references")
            self.say(f"reference of {name}")
        programs = {}
        for method in self.methods:
            programs[method] = Program([scenes[name] for name in names], method)
            self.say(f"compiled {method.name}, {method.samples} samples")
        for name in names:
            scene, truth = scenes[name], self.references[name]
            images = {method: program.draw(scene) for method, program in programs.items()}
            self.images |= {(name, method): image for method, image in images.items()}
            self.rows += _rows(name, scene, truth, images, programs)
            if name in probes_or_ewa.SCENES:
                self.compared += probes_or_ewa.compare(scene, name, truth, programs)
            self.measured.add(name)
            self.say(f"measured {name}")


def _rows(
    name: str,
    scene: sr.Scene,
    truth: np.ndarray,
    images: dict[Method, np.ndarray],
    programs: dict[Method, Program],
) -> list[dict[str, Any]]:
    """A row for each method on a scene."""
    times = {}
    if name in TIMED:
        calls = {
            method: functools.partial(program.run, scene)
            for method, program in programs.items()
            if method.samples * method.texels <= MOST_TEXELS
        }
        times = interleave(
            {str(method): call for method, call in calls.items()}, rounds=5, budget_s=5.0
        )
    rows = []
    for method, image in images.items():
        row: dict[str, Any] = {"scene": name, "filter": method.name} | method._asdict()
        row["rmse"] = rmse(image, truth)
        zone = subjects.base(scene, subjects.FLAT.index(name)) if name == "zone_plate" else None
        row["moire"] = "" if zone is None else moire(image, truth, zone)
        row["median_ms"] = row["over_yardstick"] = ""
        if str(method) in times:
            row["median_ms"] = times[str(method)].median
            row["over_yardstick"] = times[str(method)].median / times[str(YARDSTICK)].median
        row["texels"] = method.texels
        row["traffic_mb"] = programs[method].traffic / 1e6
        rows.append(row)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(
        description="Measure the error, moire, time and bytes of texture filters."
    )
    parser.add_argument(
        "--quick", action="store_true", help="Measure few filters; results go to cache/quick."
    )
    parser.add_argument("--resume", action="store_true", help="Continue an interrupted run.")
    arguments = parser.parse_args()
    quick = arguments.quick
    cache_programs(CACHE / "xla")
    results = CACHE / "quick" if quick else HERE / "results"

    state = CACHE / ("quick.pickle" if quick else "run.pickle")
    run = pickle.loads(state.read_bytes()) if arguments.resume else Run(quick)
    scenes = subjects.load(SEED)
    for names in (subjects.FLAT, (subjects.GROUND,)):
        if names[-1] not in run.measured:
            run.measure(scenes, names)
            state.write_bytes(pickle.dumps(run))
    report.write_csv(results / "filters.csv", run.rows)
    report.write_csv(results / "probes_or_ewa.csv", run.compared)
    pictures.write(results / "filters.png", run.images, run.references)
    about = {
        "seed": SEED,
        "precision": "float32",
        "jax_enable_x64": False,
        "size_px": subjects.SIZE,
        "pyramids": subjects.pyramids(SEED),
        "machine": machine.record(PACKAGES),
        "seconds": round(time.time() - run.began),
    }
    report.write_json(results / "run.json", about)
    tables.publish(results, None if quick else HERE / "README.md")
    run.say("done")


if __name__ == "__main__":
    main()
