"""Measure error against time, for images and for gradients; see the README in this folder.

python -m experiments.accuracy_vs_time.run [--quick] [--only SCENE,SCENE]
"""

# pyright: reportMissingImports=false

import argparse
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

import softras2d
from softras2d.comparison.flip import mean_flip

from ..common import machine, progress, report
from ..common.references import cache_programs
from ..common.timing import Times, interleave
from ..gradient_accuracy.run import cosine, error
from ..hard_speed.ours import CORES
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


def image_rows(subject: Subject, quick: bool, has_peers: bool = True) -> list[dict[str, Any]]:
    """A row for each method of drawing a scene; all methods are timed in turn."""
    contestants = [
        contestant
        for contestant in ways.contestants(subject, quick)
        if has_peers or contestant.family in ways.OURS
    ]
    drawn = [contestant.draw for contestant in contestants if contestant.family in ways.OURS]
    compile_together([lambda: subjects.reference(subject, REFERENCES), *drawn])
    reference = subjects.reference(subject, REFERENCES)
    images = {
        contestant.name: np.asarray(contestant.image(contestant.draw()))
        for contestant in contestants
    }
    times = _timed({contestant.name: contestant.draw for contestant in contestants}, quick)
    return [
        {
            "scene": subject.name,
            "family": contestant.family,
            "label": contestant.sampling,
            "threads": contestant.threads,
            "median_ms": times[contestant.name].median,
            "least_ms": times[contestant.name].least,
            "calls": times[contestant.name].calls,
            "rmse": float(np.sqrt(np.mean((images[contestant.name] - reference) ** 2))),
            "flip": mean_flip(images[contestant.name], reference),
        }
        for contestant in contestants
    ]


def gradient_rows(subject: Subject, quick: bool, has_peers: bool = True) -> list[dict[str, Any]]:
    """A row for each method of differentiating a scene; all methods are timed in turn."""
    truth = gradients.truth(subject, subjects.reference(subject, REFERENCES))
    methods = {
        f"{method.family}, {method.label}": method
        for method in gradients.methods_of(subject, quick)
        if has_peers or method.family in ways.OURS
    }
    compile_together(method.call for method in methods.values() if method.family in ways.OURS)
    by_method = {name: method.read(method.call()) for name, method in methods.items()}
    times = _timed({name: method.call for name, method in methods.items()}, quick)
    return [
        {
            "scene": subject.name,
            "family": method.family,
            "label": method.label,
            "threads": method.threads,
            "median_ms": times[name].median,
            "least_ms": times[name].least,
            "calls": times[name].calls,
            "relative_error": error(by_method[name], truth),
            "one_minus_cosine": 1 - cosine(by_method[name], truth),
        }
        for name, method in methods.items()
    ]


def _timed(calls: dict[str, Callable[[], object]], quick: bool) -> dict[str, Times]:
    rounds, budget_s = (3, 3.0) if quick else (9, 8.0)
    return interleave(calls, rounds=rounds, budget_s=budget_s)


def compile_together(calls: Iterable[Callable[[], object]]) -> None:
    """Compile each method by one call, in as many threads as cores: compiling uses one core."""
    with ThreadPoolExecutor(CORES) as pool:
        for done in [pool.submit(call) for call in calls]:
            done.result()


def _check_earlier(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> None:
    """End with a message unless the imported package is another one than that of this checkout."""
    if arguments.quick or arguments.only:
        parser.error("--earlier measures all scenes: leave out --quick and --only.")
    package = Path(softras2d.__file__ or "").resolve()
    if package.is_relative_to(Path(__file__).resolve().parents[2]):
        parser.error(f"--earlier needs another version of softras2d; {package} is this one.")


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure error against time.")
    parser.add_argument(
        "--quick", action="store_true", help="Measure few points; results go to cache/quick."
    )
    parser.add_argument(
        "--only", default="", help="Names of scenes, separated by commas; results go to cache/only."
    )
    parser.add_argument(
        "--earlier",
        default="",
        metavar="NAME",
        help="Measure only softras2d, an earlier version of it (see the README); results go to "
        "results/earlier. The figures show them in grey under this name.",
    )
    arguments = parser.parse_args()
    has_peers = not arguments.earlier
    if arguments.earlier:
        _check_earlier(parser, arguments)
    quick, only = arguments.quick, {name for name in arguments.only.split(",") if name}
    cache_programs(CACHE / "xla")
    results = HERE / "results"
    if quick or only:
        results = CACHE / ("quick" if quick else "only")
    elif arguments.earlier:
        results = HERE / "results" / "earlier"
    size = QUICK_SIZE if quick else SIZE
    began, about = time.perf_counter(), machine.record(PACKAGES)
    chosen = [one for one in subjects.load(size) if not only or one.name in only]
    for name in ways.missing():
        print(f"left out because it is not installed: {name}")
    # A run of textured scenes alone has no gradients, and must not show those of an earlier run.
    (results / "gradients.csv").unlink(missing_ok=True)
    images: list[dict[str, Any]] = []
    gradient_results: list[dict[str, Any]] = []
    for name, subject in progress.steps({one.name: one for one in chosen}.items(), "scenes"):
        images += image_rows(subject, quick, has_peers)
        # The exact gradient does not support textures.
        if not subject.textured and (not quick or name in QUICK_GRADIENTS):
            gradient_results += gradient_rows(subject, quick, has_peers)
        report.write_csv(results / "images.csv", images)
        if gradient_results:
            report.write_csv(results / "gradients.csv", gradient_results)
        print(f"{time.perf_counter() - began:5.0f} s  {name}", flush=True)
    run = {
        "seed": subjects.SEED,
        "target_seed": gradients.TARGET_SEED,
        "precision": "float32",
        "jax_enable_x64": False,
        "truth": "1024 samples per pixel: Hard(256) on a canvas of twice the size",
        "size_px": size,
        "threads": CORES,
        "titles": {one.name: one.title for one in chosen},
        "left_out": ways.missing(),
        "version": arguments.earlier,
        "machine": about,
        "seconds": round(time.perf_counter() - began),
    }
    report.write_json(results / "run.json", run)
    if not arguments.earlier:
        tables.publish(results, None if quick or only else HERE / "README.md")


if __name__ == "__main__":
    main()
