"""Measure error against time, for images and for gradients; see the README beside this.

python -m experiments.accuracy_vs_time.run [--quick] [--only SCENE,SCENE]
"""

# pyright: reportMissingImports=false

import argparse
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import flip_evaluator
import jax
import numpy as np
from numpy.typing import NDArray

from ..common import machine, progress, report
from ..common.timing import Times, interleave
from ..gradient_accuracy.run import cosine, error
from ..hard_speed.own import CORES
from . import gradients, subjects, tables, ways
from .subjects import Subject

HERE = Path(__file__).parent
CACHE = HERE / "cache"
REFERENCES = CACHE / "references"
SIZE, QUICK_SIZE = 512, 192
QUICK_GRADIENTS = ("flat", "mesh")
PACKAGES = (
    "softras2d",
    "jax",
    "jaxlib",
    "numpy",
    "numba",
    "flip-evaluator",
    "deodr",
    "skia-python",
    "blend2d-py",
    "pycairo",
    "opencv-python-headless",
)


def image_rows(subject: Subject, quick: bool) -> list[dict[str, Any]]:
    """A row for each way of drawing a scene; all are timed in turn."""
    found = ways.contestants(subject, quick)
    drawn = [one.draw for one in found if one.family in ways.OWN]
    compile_together([lambda: subjects.reference(subject, REFERENCES), *drawn])
    truth = subjects.reference(subject, REFERENCES)
    images = {one.name: np.asarray(one.image(one.draw())) for one in found}
    times = _timed({one.name: one.draw for one in found}, quick)
    return [
        {
            "scene": subject.name,
            "family": one.family,
            "label": one.sampling,
            "threads": one.threads,
            "median_ms": times[one.name].median,
            "least_ms": times[one.name].least,
            "calls": times[one.name].calls,
            "rmse": float(np.sqrt(np.mean((images[one.name] - truth) ** 2))),
            "flip": mean_flip(truth, images[one.name]),
        }
        for one in found
    ]


def gradient_rows(subject: Subject, quick: bool) -> list[dict[str, Any]]:
    """A row for each way of differentiating a scene; all are timed in turn."""
    truth = gradients.truth(subject, subjects.reference(subject, REFERENCES))
    found = {f"{one.family}, {one.label}": one for one in gradients.slopes(subject, quick)}
    compile_together(one.call for one in found.values() if one.family in ways.OWN)
    slopes = {name: one.read(one.call()) for name, one in found.items()}
    times = _timed({name: one.call for name, one in found.items()}, quick)
    return [
        {
            "scene": subject.name,
            "family": one.family,
            "label": one.label,
            "threads": one.threads,
            "median_ms": times[name].median,
            "least_ms": times[name].least,
            "calls": times[name].calls,
            "relative_error": error(slopes[name], truth),
            "one_minus_cosine": 1 - cosine(slopes[name], truth),
        }
        for name, one in found.items()
    ]


def mean_flip(truth: NDArray[np.float64], image: NDArray[Any]) -> float:
    """Mean FLIP of two images in display values, at the evaluator's 67 pixels a degree."""
    held, seen = (np.clip(one, 0, 1).astype(np.float32) for one in (truth, image))
    return float(flip_evaluator.evaluate(held, seen, "LDR", applyMagma=False)[1])


def _timed(calls: dict[str, Callable[[], object]], quick: bool) -> dict[str, Times]:
    rounds, budget_s = (3, 3.0) if quick else (9, 8.0)
    return interleave(calls, rounds=rounds, budget_s=budget_s)


def compile_together(calls: Iterable[Callable[[], object]]) -> None:
    """Call each once: a compilation keeps one core busy, so as many at a time as there are."""
    with ThreadPoolExecutor(CORES) as pool:
        for done in [pool.submit(call) for call in calls]:
            done.result()


def keep_programs() -> None:
    """More than a hundred programs, which a second run need not compile again."""
    jax.config.update("jax_compilation_cache_dir", str(CACHE / "xla"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def main() -> None:
    parser = argparse.ArgumentParser(description="Error against milliseconds.")
    parser.add_argument("--quick", action="store_true", help="few points, into cache/quick")
    parser.add_argument("--only", default="", help="scenes by comma, into cache/only")
    arguments = parser.parse_args()
    quick, only = arguments.quick, {name for name in arguments.only.split(",") if name}
    keep_programs()
    results = HERE / "results"
    if quick or only:
        results = CACHE / ("quick" if quick else "only")
    size = QUICK_SIZE if quick else SIZE
    began, about = time.perf_counter(), machine.record(PACKAGES)
    chosen = [one for one in subjects.load(size) if not only or one.name in only]
    for name in ways.missing():
        print(f"left out, not installed: {name}")
    # A run of textures alone has no gradients, and must not show those of a run before.
    (results / "gradients.csv").unlink(missing_ok=True)
    images: list[dict[str, Any]] = []
    slopes: list[dict[str, Any]] = []
    for name, subject in progress.steps({one.name: one for one in chosen}.items(), "scenes"):
        images += image_rows(subject, quick)
        # The exact gradient knows no textures.
        if not subject.textured and (not quick or name in QUICK_GRADIENTS):
            slopes += gradient_rows(subject, quick)
        report.write_csv(results / "images.csv", images)
        if slopes:
            report.write_csv(results / "gradients.csv", slopes)
        print(f"{time.perf_counter() - began:5.0f} s  {name}", flush=True)
    run = {
        "seed": subjects.SEED,
        "target_seed": gradients.TARGET_SEED,
        "precision": "float32",
        "jax_enable_x64": False,
        "truth": "1024 samples a pixel: Hard(256) on a canvas of twice the size",
        "size_px": size,
        "threads": CORES,
        "titles": {one.name: one.title for one in chosen},
        "left_out": ways.missing(),
        "machine": about,
        "seconds": round(time.perf_counter() - began),
    }
    report.write_json(results / "run.json", run)
    tables.publish(results, None if quick or only else HERE / "README.md")


if __name__ == "__main__":
    main()
