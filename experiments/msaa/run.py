"""Compare supersampling, multisampling and three variants of it; see the README in this folder.

python -m experiments.msaa.run [--quick]
"""

import argparse
import functools
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np

import softras2d as sr
from softras2d import scenes

from ..common import machine, report
from ..common.timing import interleave
from . import pictures, subjects, tables
from .samples import sample_points, triangles
from .variants import VARIANTS, owners

HERE = Path(__file__).parent
CACHE = HERE / "cache"
PACKAGES = ("softras2d", "jax", "jaxlib", "numpy", "matplotlib")
SHADINGS = {"SSAA": "sample", "MSAA": "pixel"}
SHOWN = 4
"""Samples per pixel in the contact sheet: 2 x 2, as in courses."""
TIMED = 16


def main() -> None:
    parser = argparse.ArgumentParser(
        description="Compare supersampling and variants of multisampling."
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="Draw only 4 samples per pixel; results go to cache/quick.",
    )
    quick = parser.parse_args().quick
    jax.config.update("jax_compilation_cache_dir", str(CACHE / "xla"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    results = CACHE / "quick" if quick else HERE / "results"
    began = time.perf_counter()
    rows, shown = [], {}
    for samples in (SHOWN,) if quick else (SHOWN, TIMED):
        for name in subjects.NAMES:
            found, images = measure(name, samples)
            rows += found
            if samples == SHOWN:
                shown[name] = images
            print(f"{time.perf_counter() - began:5.0f} s  {name}, {samples} samples", flush=True)
    report.write_csv(results / "methods.csv", rows)
    pictures.sheet(results / "methods.png", shown, SHOWN)
    report.save_figure(pictures.explanation(), results / "one_pixel.png")
    report.write_csv(results / "times.csv", measure_times(SHOWN if quick else TIMED))
    run = {
        "precision": "float32, the variants float64",
        "jax_enable_x64": False,
        "size_px": subjects.SIZE,
        "machine": machine.record(PACKAGES),
        "seconds": round(time.perf_counter() - began),
    }
    report.write_json(results / "run.json", run)
    tables.publish(results, None if quick else HERE / "README.md")


def measure(name: str, samples: int) -> tuple[list[dict[str, Any]], dict[str, np.ndarray]]:
    """Rows, one for each method, and images by method; the reference is the last image."""
    scene = subjects.read(name)
    truth = subjects.reference(scene, CACHE / "references")
    drawn = list(triangles(scene, subjects.SIZE))
    points = sample_points(subjects.SIZE, {4: 2, 16: 4}[samples])
    owner = owners(drawn, points)
    images: dict[str, np.ndarray] = {}
    shaded: dict[str, int] = {}
    for method, shading in SHADINGS.items():
        plan = subjects.plan(scene, samples, shading)
        images[method] = np.asarray(sr.render(scene, plan), np.float64)
    shaded["SSAA"] = int((owner >= 0).sum())
    background = np.asarray(scene.background, np.float64)
    for method, draw in VARIANTS.items():
        images[method], shaded[method] = draw(drawn, points, background)
    # Both shade each triangle once in each pixel where it is visible.
    shaded["MSAA"] = shaded["c: depth and colour a sample"]
    covered = int((owner >= 0).any(axis=-1).sum())
    rows = []
    for method, image in images.items():
        off = np.abs(image - images["MSAA"]).max(axis=-1)
        row = {
            "scene": name,
            "method": method,
            "samples": samples,
            "rmse": float(np.sqrt(((image - truth) ** 2).mean())),
            # SSAA differs from MSAA by shading only, which does not count as wrong.
            "wrong": "" if method == "SSAA" else float((off > 1 / 255).mean()),
            "furthest": float(off.max()),
            "shaded": shaded[method] / covered,
        }
        rows.append(row)
    return rows, images | {"1024 samples": truth}


def measure_times(samples: int) -> list[dict[str, Any]]:
    """Times of the package, for each scene with its colours and textures, and with flat colours."""
    subjects_timed = {
        "crossing": (subjects.read("crossing"), subjects.FILTER),
        "carpets": (subjects.read("carpets"), subjects.FILTER),
        "ground, trilinear": (_ground(), sr.Filter()),
    }
    rows = []
    for name, (scene, filter) in subjects_timed.items():
        flat = subjects.flat(scene)
        cases = {"flat": (flat, subjects.plan(flat, samples, "sample"))}
        for method, shading in SHADINGS.items():
            cases[method] = scene, subjects.plan(scene, samples, shading, filter)
        calls = {method: functools.partial(_draw, *case) for method, case in cases.items()}
        times = interleave(calls, rounds=15, budget_s=20.0)
        for method, measured in times.items():
            row: dict[str, Any] = {"scene": name, "method": method, "samples": samples}
            row |= {"median_ms": measured.median, "least_ms": measured.least}
            row["median_over_flat"] = measured.median / times["flat"].median
            row["least_over_flat"] = measured.least / times["flat"].least
            rows.append(row)
    return rows


def _ground() -> sr.Scene:
    """The bundled ground plane without depth, as a plane does not hide itself."""
    size = subjects.SIZE
    return replace(scenes.read("ground", height=size, width=size), depth=None)


def _draw(scene: sr.Scene, plan: sr.Plan) -> None:
    jax.block_until_ready(sr.render(scene, plan))


if __name__ == "__main__":
    main()
