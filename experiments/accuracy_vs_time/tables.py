"""Make the tables and the figures from the stored results.

python -m experiments.accuracy_vs_time.tables
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..common import machine, report
from . import figure
from .points import Point, ahead, front, quickest, read

HERE = Path(__file__).parent
IMAGE_BOUNDS = (0.02, 0.01, 0.005, 0.002, 0.001)
FLIP_BOUNDS = (0.05, 0.02, 0.01, 0.005)
GRADIENT_BOUNDS = (0.5, 0.2, 0.1, 0.05)
_LABELS = (
    "16, 4x4: samples per pixel, or a canvas 4 times as wide, averaged.\n"
    "AA: anti-aliased by coverage.\n"
)
_TEXTURES = (
    "Textured panel: without `mip`, bilinear and no mip level; `mip`, hollow:\n"
    "trilinear; `mip -2`: level lowered by 2. Cairo best: its best filter.\n"
)
_GRADIENTS = (
    "Of the mean squared difference to white noise.\n"
    "softras2d: all cores; DEODR: one thread; 4x4: on a canvas 4 times as wide.\n"
)


def publish(results: Path, readme: Path | None) -> None:
    """Draw the figures, and put the tables into `readme` (None: print them)."""
    images = report.read_csv(results / "images.csv")
    path = results / "gradients.csv"
    gradient_rows = report.read_csv(path) if path.exists() else []
    run = json.loads((results / "run.json").read_text())
    titles, size = run["titles"], run["size_px"]
    by_rmse, by_flip = read(images, "rmse"), read(images, "flip")
    by_gradient = read(gradient_rows, "relative_error")
    earlier_run = results / "earlier" / "run.json"
    version = json.loads(earlier_run.read_text())["version"] if earlier_run.exists() else ""
    earlier = {
        name: _earlier(results, file, column)
        for name, file, column in (
            ("rmse", "images.csv", "rmse"),
            ("flip", "images.csv", "flip"),
            ("gradients", "gradients.csv", "relative_error"),
        )
    }
    threads = f"softras2d and the scanline: {run['threads']} threads, others one.\n"
    square = f"{size} x {size} px."
    about = _LABELS + _TEXTURES + threads + square
    for name, points, what, note in (
        ("rmse", by_rmse, "RMSE to 1024 samples", about),
        ("flip", by_flip, "mean FLIP to 1024 samples", about),
        ("gradients", by_gradient, "relative error of the position gradient", _GRADIENTS + square),
    ):
        if not points:
            continue
        shown = {scene: titles[scene] for scene in dict.fromkeys(p.scene for p in points)}
        time_label = (
            "median time of forward and backward, ms"
            if points is by_gradient
            else "median time, ms"
        )
        drawn = figure.draw(points, earlier[name], version, shown, time_label, what, note)
        for suffix in ("png", "svg"):
            report.save_figure(drawn, results / f"{name}.{suffix}")
        figure.pyplot.close(drawn)
    texts = {
        "quickest-image": _quickest_table(by_rmse, titles, IMAGE_BOUNDS, "RMSE"),
        "quickest-flip": _quickest_table(by_flip, titles, FLIP_BOUNDS, "FLIP"),
        "quickest-gradient": _quickest_table(
            by_gradient, titles, GRADIENT_BOUNDS, "relative error"
        ),
        "ahead-image": _ahead(by_rmse, titles, "RMSE"),
        "ahead-gradient": _ahead(by_gradient, titles, "relative error"),
        "images": _images(images, titles),
        "gradients": _gradients(gradient_rows, titles),
        "left-out": _left_out(run["left_out"]),
        "machine": _machine(run),
    }
    report.fill_or_print(readme, texts)


def _earlier(results: Path, file: str, error_name: str) -> list[Point]:
    """The points of an earlier version of softras2d; none if it was not measured."""
    path = results / "earlier" / file
    return read(report.read_csv(path), error_name) if path.exists() else []


def _quickest_table(
    points: Sequence[Point], titles: dict[str, str], bounds: Sequence[float], error_name: str
) -> str:
    """For each bound on the error, the fastest method and the fastest mode of softras2d."""
    header = ["scene", f"{error_name} at most", "quickest of all", "ms", "softras2d's quickest",
              "ms", "softras2d / quickest"]  # fmt: skip
    lines = []
    for scene in dict.fromkeys(point.scene for point in points):
        of_scene = [point for point in points if point.scene == scene]
        for bound in bounds:
            best = quickest(of_scene, bound)
            ours = quickest([point for point in of_scene if point.is_ours], bound)
            ratio = f"{ours.ms / best.ms:.2f}" if ours and best else ""
            lines.append([titles[scene], f"{bound:g}", *_cells(best), *_cells(ours), ratio])
    return report.table(header, lines)


def _cells(point: Point | None) -> tuple[str, str]:
    return (point.name, f"{point.ms:.1f}") if point else ("none", "")


def _ahead(points: Sequence[Point], titles: dict[str, str], error_name: str) -> str:
    """Table of peers that are faster than all methods of softras2d with as low an error."""
    header = ["scene", "peer", "ms", error_name, "softras2d's quickest with as low an error", "ms",
              error_name, "softras2d / peer"]  # fmt: skip
    lines = []
    for scene in dict.fromkeys(point.scene for point in points):
        for peer, match in ahead([point for point in points if point.scene == scene]):
            ratio = f"{match.ms / peer.ms:.2f}" if match else ""
            error = f"{match.error:.2g}" if match else ""
            row = [*_cells(peer), f"{peer.error:.2g}", *_cells(match), error, ratio]
            lines.append([titles[scene], *row])
    return report.table(header, lines) if lines else "None in this run."


def _images(rows: Sequence[dict[str, Any]], titles: dict[str, str]) -> str:
    header = ["way", "threads", "median ms", "least ms", "RMSE", "FLIP", "on the Pareto front of"]
    return _by_scene(rows, titles, {"RMSE": "rmse", "FLIP": "flip"}, header)


def _gradients(rows: Sequence[dict[str, Any]], titles: dict[str, str]) -> str:
    errors = {"relative error": "relative_error", "1 - cosine": "one_minus_cosine"}
    header = ["way", "threads", "median ms", "least ms", *errors, "on the Pareto front of"]
    return _by_scene(rows, titles, errors, header)


def _by_scene(
    rows: Sequence[dict[str, Any]],
    titles: dict[str, str],
    errors: dict[str, str],
    header: list[str],
) -> str:
    """A table for each scene, the fastest method first."""
    sections = []
    for scene in dict.fromkeys(row["scene"] for row in rows):
        scene_rows = [row for row in rows if row["scene"] == scene]
        fronts = {
            error_name: {p.name for p in front(read(scene_rows, key))}
            for error_name, key in errors.items()
        }
        lines = []
        for row in sorted(scene_rows, key=lambda row: float(row["median_ms"])):
            name = f"{row['family']}, {row['label']}"
            on = ", ".join(error_name for error_name, names in fronts.items() if name in names)
            times = [f"{float(row[key]):.1f}" for key in ("median_ms", "least_ms")]
            error_cells = [f"{float(row[key]):.2g}" for key in errors.values()]
            lines.append([name, row["threads"], *times, *error_cells, on])
        sections.append(f"**{titles[scene]}**\n\n{report.table(header, lines)}")
    return "\n\n".join(sections)


def _left_out(names: Sequence[str]) -> str:
    if not names:
        return "All peers were installed in this run."
    return f"Not installed in this run, and left out: {', '.join(names)}."


def _machine(run: dict[str, Any]) -> str:
    seeds = f"seed {run['seed']} of the scenes, {run['target_seed']} of the noise"
    about = machine.describe(run, seed=seeds)
    load = run["machine"]["load_average_1min"]
    return (
        f"{about}; {run['size_px']} x {run['size_px']} px; load average at the start {load:.1f}; "
        f"{run['seconds'] / 60:.1f} minutes, compilation included."
    )


if __name__ == "__main__":
    publish(HERE / "results", HERE / "README.md")
