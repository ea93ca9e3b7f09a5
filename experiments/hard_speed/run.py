"""Time exact supersampling against compiled loops and 2-D libraries; see the README in this folder.

python -m experiments.hard_speed.run [--quick] [--only FAMILY,FAMILY]
"""

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..common import machine, report, scanline
from ..common.scenes import COUNTS, KINDS, SIZES_PX, Soup, random_soup
from ..common.timing import Times, interleave
from . import check, fresh, ours, peers, tables
from .contestant import Contestant
from .peers.canvas import LARGE_ANTI_ALIASED

HERE = Path(__file__).parent
CACHE = HERE / "cache"
PACKAGES = (
    "softras2d",
    "jax",
    "jaxlib",
    "numpy",
    "numba",
    "skia-python",
    "blend2d-py",
    "opencv-python-headless",
    "pycairo",
)


class Cell(NamedTuple):
    """One scene: softras2d at all `samples`, the loops at all `loop_samples`.

    The slowest contestants draw fewer scenes, as their times grow like those of faster ones:
    the scalar loop draws only scenes of 512 px, and anti-aliasing on a large canvas only the scene
    that all contestants draw.
    """

    kind: str
    count: int
    size: int
    samples: tuple[int, ...]
    loop_samples: tuple[int, ...]


def cells(quick: bool, every: bool = False) -> Iterator[Cell]:
    """Scenes to draw: all numbers of samples for 1000 triangles at 512 px, else 16 samples.

    Without `every`, only the scenes that the targets need: all numbers of flat opaque
    triangles at 512 px, and 1000 and 100,000 triangles of the other kinds.
    """
    if quick:
        yield Cell("flat", 1000, 512, (1, 4, 16, 64), (16,))
        return
    for kind in KINDS:
        for size in SIZES_PX:
            for count in COUNTS:
                flat = kind == "flat"
                asked = count in (1000, 100_000) and (flat or size == 512)
                if not (every or asked or (flat and size == 512)):
                    continue
                if count == 1000 and size == 512:
                    rates = (1, 4, 16, 64, 256) if flat else (1, 4, 16, 64)
                    yield Cell(kind, count, size, rates, (4, 16, 64) if flat else (16,))
                else:
                    yield Cell(kind, count, size, (16,), (16,))


def fresh_cells(quick: bool) -> Iterator[tuple[str, int, int, int]]:
    """Kind, triangles, size and samples of the scenes drawn in separate processes."""
    yield "flat", 1000, 512, 16
    if not quick:
        yield "flat_a50", 1000, 512, 16
        yield "gouraud", 1000, 512, 16
        yield "flat", 1000, 4096, 16
        yield "flat", 100_000, 4096, 16


def contestants(cell: Cell, soup: Soup, only: set[str]) -> list[Contestant]:
    chosen = []
    if not only or "softras2d" in only:
        chosen += [ours.softras2d(soup, samples) for samples in cell.samples]
    for samples in cell.loop_samples:
        for threads in sorted({1, ours.CORES}):
            chosen.append(ours.loop(soup, samples, threads, by_rows=True))
            if cell.size == 512:
                chosen.append(ours.loop(soup, samples, threads, by_rows=False))
    everybody = (cell.count, cell.size) == (1000, 512)
    chosen += [
        contestant
        for contestant in peers.contestants(soup)
        if everybody or contestant.sampling != LARGE_ANTI_ALIASED
    ]
    return [contestant for contestant in chosen if not only or contestant.family in only]


def run_cell(cell: Cell, only: set[str], budget_s: float) -> list[dict[str, Any]]:
    """One row for each contestant."""
    soup = random_soup(cell.count, cell.size, cell.kind)
    truth = scanline.truth(soup, CACHE)
    drawn = contestants(cell, soup, only)
    rmse = {
        contestant.name: _rmse(contestant.image(contestant.draw()), truth) for contestant in drawn
    }
    times = interleave(
        {contestant.name: contestant.draw for contestant in drawn}, budget_s=budget_s
    )
    return [
        _row(cell, contestant, times[contestant.name], rmse[contestant.name])
        for contestant in drawn
    ]


def _row(cell: Cell, contestant: Contestant, times: Times, rmse: float | None) -> dict[str, Any]:
    return {
        "kind": cell.kind,
        "triangles": cell.count,
        "size_px": cell.size,
        "family": contestant.family,
        "sampling": contestant.sampling,
        "threads": contestant.threads,
        "median_ms": times.median,
        "least_ms": times.least,
        "cpu_ms": times.cpu,
        "calls": times.calls,
        "rmse": "" if rmse is None else rmse,
    }


def _rmse(image: np.ndarray, truth: np.ndarray) -> float | None:
    """The RMSE of an image; None for contestants that time calls alone and draw no image."""
    if image.shape != truth.shape:
        return None
    return float(np.sqrt(np.mean((image.astype(np.float64) - truth) ** 2)))


def measure_fresh(quick: bool) -> list[dict[str, Any]]:
    """First renders and peak memory, each in a separate process."""
    rows = []
    for kind, count, size, samples in fresh_cells(quick):
        about = {"kind": kind, "triangles": count, "size_px": size, "samples": samples}
        rows.append(about | fresh.measure(kind, count, size, samples))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure the time of exact supersampling.")
    parser.add_argument(
        "--quick", action="store_true", help="Draw only one scene; results go to cache/quick."
    )
    parser.add_argument("--all", action="store_true", help="Draw every scene at both sizes.")
    parser.add_argument(
        "--fresh", action="store_true", help="Measure only first renders and memory again."
    )
    parser.add_argument(
        "--only", default="", help="Renderers, separated by commas: softras2d,Skia,..."
    )
    arguments = parser.parse_args()
    only = {name for name in arguments.only.split(",") if name}
    results = CACHE / "quick" if arguments.quick or only else HERE / "results"

    if arguments.fresh:
        run = json.loads((results / "run.json").read_text())
        run["fresh"] = measure_fresh(quick=False)
        report.write_json(results / "run.json", run)
        tables.publish(results, HERE / "README.md")
        return
    began = time.perf_counter()
    check.main()
    for name in peers.missing():
        print(f"left out because its library is not installed: {name}")
    run: dict[str, Any] = {
        "seed": 0,
        "precision": "float32",
        "jax_enable_x64": False,
        "truth": f"{scanline.TRUTH_RATE}x{scanline.TRUTH_RATE} samples",
        "machine": machine.record(PACKAGES),
        "fresh": [],
    }
    rows: list[dict[str, Any]] = []
    for cell in cells(arguments.quick, arguments.all):
        rows += run_cell(cell, only, budget_s=6.0)
        report.write_csv(results / "times.csv", rows)
        seconds = time.perf_counter() - began
        print(f"{seconds:5.0f} s  {cell.kind} {cell.count} {cell.size} px", flush=True)
    if not only or "softras2d" in only:
        run["fresh"] = measure_fresh(arguments.quick)
    run["seconds"] = round(time.perf_counter() - began)
    report.write_json(results / "run.json", run)
    tables.publish(results, None if arguments.quick or only else HERE / "README.md")


if __name__ == "__main__":
    main()
