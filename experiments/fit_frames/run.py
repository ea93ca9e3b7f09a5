"""Measure the flicker, the PSNR and the time of films that are fitted frame after frame.

python -m experiments.fit_frames.run [--frames 30] [--triangles 200]
"""

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

import softras2d as sr
from softras2d.comparison.flicker import flicker
from softras2d.fitting.resample import shrink

from ..common import machine, progress, report

HERE = Path(__file__).parent
PACKAGES = ("softras2d", "jax", "jaxlib", "optax", "numpy")
SEED = 0

HEIGHT, WIDTH = 128, 192
WEIGHTS = (0.0, 0.3, 1.0, 3.0)
STEPS, FRAME_STEPS = 500, 60

Film = list[np.ndarray]


def crossing(frames: int) -> Film:
    """Make a film in which a disc of fruit crosses a valley that stands still."""
    valley = shrink(sr.read_image(sr.pictures.path("valley")), HEIGHT, WIDTH)
    fruit = shrink(sr.read_image(sr.pictures.path("fruit")), 64, 64)
    y, x = np.mgrid[:64, :64] + 0.5
    is_disc = np.hypot(x - 32, y - 32) < 28
    film = []
    for left in np.linspace(0, WIDTH - 64, frames).round().astype(int):
        image = valley.copy()
        image[32:96, left : left + 64][is_disc] = fruit[is_disc]
        film.append(image)
    return film


def pan(frames: int) -> Film:
    """Make a film in which the view moves right over a valley, by a pixel per frame."""
    valley = shrink(sr.read_image(sr.pictures.path("valley")), HEIGHT, WIDTH + frames - 1)
    return [np.ascontiguousarray(valley[:, k : k + WIDTH]) for k in range(frames)]


FILMS = {"crossing": crossing, "pan": pan}


def measure(name: str, film: Film, triangles: int, temporal: float | None) -> dict[str, Any]:
    """Fit a film, and return its scores and times.

    `temporal` is the temporal weight; with None, every frame is fitted alone.
    """
    start = time.perf_counter(), time.process_time()
    # Wall-clock and processor time at which each frame was done.
    ends: list[tuple[float, float]] = []
    if temporal is None:
        results = sr.fit_batch(film, triangles=triangles, steps=STEPS, seed=SEED)
    else:
        results = sr.fit_frames(
            film, triangles=triangles, steps=STEPS, frame_steps=FRAME_STEPS, temporal=temporal,
            seed=SEED,
            report=lambda *_: ends.append((time.perf_counter(), time.process_time())),
        )  # fmt: skip
    # The first frame includes compilation and takes more steps, so it is timed separately.
    first = ends[0] if ends else start
    last = ends[-1] if ends else (time.perf_counter(), time.process_time())
    later_frames = len(film) - bool(ends)
    return {
        "film": name,
        "temporal": "alone" if temporal is None else temporal,
        "psnr": float(np.mean([result.psnr for result in results])),
        "last_psnr": results[-1].psnr,
        "flicker": 255 * flicker([result.image for result in results], film),
        "first_seconds": first[0] - start[0],
        "frame_seconds": (last[0] - first[0]) / later_frames,
        "frame_cpu_seconds": (last[1] - first[1]) / later_frames,
    }


def row_texts(row: dict[str, Any]) -> list[str]:
    """Format a row of the README's table."""
    temporal = row["temporal"]
    flicker_text = "" if np.isnan(row["flicker"]) else f"{row['flicker']:.2f}"
    return [
        row["film"],
        temporal if temporal == "alone" else f"{temporal:g}",
        f"{row['psnr']:.2f}",
        f"{row['last_psnr']:.2f}",
        flicker_text,
        f"{row['frame_seconds']:.2f}",
        f"{row['frame_cpu_seconds']:.2f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--triangles", type=int, default=200)
    arguments = parser.parse_args()
    start_seconds = time.perf_counter()
    work = [("crossing", None), *((name, weight) for name in FILMS for weight in WEIGHTS)]
    rows = [
        measure(name, FILMS[name](arguments.frames), arguments.triangles, weight)
        for name, weight in progress.steps(work, "films")
    ]
    results = HERE / "results"
    report.write_csv(results / "films.csv", rows)
    run = {
        "machine": machine.record(PACKAGES),
        "precision": "float32",
        "seconds": time.perf_counter() - start_seconds,
        **vars(arguments),
    }
    report.write_json(results / "run.json", run)
    header = (
        "film", "temporal weight", "mean PSNR, dB", "PSNR of the last frame, dB",
        "flicker, levels", "wall-clock s per frame", "CPU s per frame",
    )  # fmt: skip
    table = report.table(header, [row_texts(row) for row in rows])
    described = machine.describe(run, seed=f"seed {SEED}")
    texts = {"films": table, "machine": f"{described}; {run['seconds'] / 60:.0f} minutes."}
    report.fill_or_print(HERE / "README.md", texts)


if __name__ == "__main__":
    main()
