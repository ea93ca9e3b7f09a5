"""Make the tables and the figure from the stored results.

python -m experiments.hard_speed.tables
"""

import json
from pathlib import Path
from typing import Any

from ..common import machine, report
from ..common.scenes import COUNTS, KINDS, SIZES_PX
from . import figure
from .targets import targets
from .times import Entry, Times, load

HERE = Path(__file__).parent
PROJECT = HERE.parent.parent
KIND_NAMES = {
    "flat": "Flat colours, opaque",
    "flat_a50": "Flat colours, alpha 0.5",
    "gouraud": "Corner colours, opaque",
    "gouraud_a50": "Corner colours, alpha 0.5",
}
# The samplings that are compared on every scene.
_SAMPLINGS = ("16 samples", "4x4 canvas", "anti-aliased")


def publish(results: Path, readme: Path | None) -> None:
    """Draw the figure, and put the tables into `readme` (None: print them)."""
    times = load(results / "times.csv")
    run = json.loads((results / "run.json").read_text())
    texts = {
        "targets": targets_table(times, run["fresh"]),
        "one-scene": one_scene_table(times),
        "all-scenes": all_scenes_tables(times),
        "machine": machine_line(run),
    }
    report.save_figure(figure.draw(times), results / "hard_speed.png")
    report.fill_or_print(readme, texts)
    if readme is not None:
        report.fill_markers(PROJECT / "README.md", "speed", speed_table(times))


def targets_table(times: Times, fresh: list[dict[str, Any]]) -> str:
    words = {True: "yes", False: "no", None: ""}
    return report.table(
        ["question", "target", "median", "least", "met"],
        [
            [row.question, row.asked, row.value, row.least, words[row.met]]
            for row in targets(times, fresh)
        ],
    )


def speed_table(times: Times) -> str:
    """The table of the project's README: flat scenes at 16 samples or on a 4x4 canvas."""
    contestants = {
        "softras2d, 16 samples": ("softras2d", "16 samples", None),
        "Skia, 4x4": ("Skia", "4x4 canvas", None),
        "Blend2D, 4x4": ("Blend2D", "4x4 canvas", None),
        "Blend2D, its own AA": ("Blend2D", "anti-aliased", None),
        "compiled scanline, one core": ("scanline", "16 samples", False),
        "two cores": ("scanline", "16 samples", True),
    }
    rows = []
    for count in COUNTS:
        entries = [
            times.find(family, sampling, triangles=count, parallel=parallel)
            for family, sampling, parallel in contestants.values()
        ]
        cells = ["" if e is None else f"{e.median_ms:.1f} ms" for e in entries]
        rows.append([f"{count:,}", *cells])
    return report.table(["triangles, flat, 512 px", *contestants], rows)


def one_scene_table(times: Times) -> str:
    """Every contestant on 1000 flat triangles at 512 px, quickest first."""
    entries = sorted(times.scene("flat", 1000, 512), key=lambda entry: entry.median_ms)
    yardstick = times.find("Skia", "4x4 canvas")
    rows = [
        [
            entry.label,
            f"{entry.median_ms:.1f}",
            f"{entry.least_ms:.1f}",
            "" if yardstick is None else f"{entry.median_ms / yardstick.median_ms:.2f}",
            "" if entry.rmse is None else f"{entry.rmse:.4f}",
        ]
        for entry in entries
    ]
    return report.table(["contestant", "median ms", "least ms", "time / Skia 4x4", "RMSE"], rows)


def all_scenes_tables(times: Times) -> str:
    """For each kind, median milliseconds and RMSE of each contestant on each scene."""
    scenes = [(size, count) for size in SIZES_PX for count in COUNTS]
    sections = []
    for kind in KINDS:
        labels = list(times.labels(kind, _SAMPLINGS))
        if labels:
            entries = {
                (entry.label, entry.size_px, entry.triangles): entry
                for size, count in scenes
                for entry in times.scene(kind, count, size)
            }
            rows = [
                [label, *(_cell(entries.get((label, *scene))) for scene in scenes)]
                for label in labels
            ]
            header = ["contestant", *(f"{size} px, {count:,}" for size, count in scenes)]
            sections.append(f"**{KIND_NAMES[kind]}**\n\n{report.table(header, rows)}")
    return "\n\n".join(sections)


def machine_line(run: dict[str, Any]) -> str:
    about = machine.describe(run, seed=f"seed {run['seed']}")
    return f"{about}; {run['seconds'] / 60:.0f} minutes."


def _cell(entry: Entry | None) -> str:
    if entry is None or entry.rmse is None:
        return ""
    return f"{entry.median_ms:.1f} ({entry.rmse:.4f})"


if __name__ == "__main__":
    publish(HERE / "results", HERE / "README.md")
