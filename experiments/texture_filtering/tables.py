"""Make the tables and the figure from the stored results.

python -m experiments.texture_filtering.tables
"""

import json
from pathlib import Path
from typing import Any

from ..common import machine, report
from . import pictures, subjects

HERE = Path(__file__).parent
_TIMED = ("stretched", subjects.GROUND)
_SCENES = (*subjects.FLAT, subjects.GROUND)

BIAS_OF = {"4": 1.0, "16": 2.0}
"""Mip levels between the spacing of pixels and the spacing of samples, by number of samples."""


def publish(results: Path, readme: Path | None) -> None:
    """Draw the figure, and put the tables into `readme` (None: print them)."""
    rows, compared = (
        report.read_csv(results / "filters.csv"),
        report.read_csv(results / "probes_or_ewa.csv"),
    )
    run = json.loads((results / "run.json").read_text())
    biases = report.read_csv(results / "bias.csv") if (results / "bias.csv").exists() else []
    lowest = [row for row in biases if float(row["lod_bias"]) == -BIAS_OF[row["samples"]]]
    figure = pictures.error_against_time(rows, lowest, _TIMED)
    report.save_figure(figure, results / "error_time.png")
    texts = {
        "filters": filters_table(rows),
        "probes-or-ewa": compared_table(compared),
        "bias": bias_table(biases) if biases else "",
        "bytes": bytes_table(run["pyramids"]),
        "machine": machine_line(run),
    }
    report.fill_or_print(readme, texts)


def filters_table(rows: list[dict[str, Any]]) -> str:
    """One row for each filter and number of samples."""
    by_cell = {(row["scene"], row["filter"], row["samples"]): row for row in rows}
    methods = dict.fromkeys((row["filter"], row["samples"]) for row in rows)
    lines = []
    for method in methods:
        by_scene = {scene: by_cell[scene, *method] for scene in _SCENES}
        lines.append(
            [
                *method,
                f"{100 * float(by_scene['zone_plate']['moire']):.1f} %",
                *(f"{float(by_scene[scene]['rmse']):.4f}" for scene in _SCENES),
                *(_ratio(by_scene[scene]) for scene in _TIMED),
                by_scene[subjects.GROUND]["texels"],
                f"{float(by_scene['stretched']['traffic_mb']):.0f}" if method[1] == "1" else "",
            ]
        )
    header = ["filter", "samples", "moire", *(scene.replace("_", " ") for scene in _SCENES)]
    times = [f"relative time, {scene}" for scene in _TIMED]
    return report.table([*header, *times, "texels per sample", "MB moved"], lines)


def _ratio(row: dict[str, Any]) -> str:
    return f"{float(row['over_yardstick']):.2f}" if row["over_yardstick"] else ""


def compared_table(rows: list[dict[str, Any]]) -> str:
    """Probes and EWA on both scenes, one row per filter."""
    scenes = dict.fromkeys(row["scene"] for row in rows)
    by_cell = {(row["scene"], row["filter"]): row for row in rows}
    lines = []
    for name in dict.fromkeys(row["filter"] for row in rows):
        filter_rows = [by_cell[scene, name] for scene in scenes]
        cells = [
            cell
            for row in filter_rows
            for cell in (
                f"{float(row['rmse']):.4f}",
                f"{float(row['mean_texels']):.1f}",
                row["most_texels"],
                row["steps"],
            )
        ]
        lines.append([name, *cells])
    columns = ("RMSE", "texels, mean", "texels, most", "steps")
    return report.table(["filter", *(f"{s}: {c}" for s in scenes for c in columns)], lines)


def bias_table(rows: list[dict[str, Any]]) -> str:
    """Trilinear with the level of detail lowered towards the spacing of the samples."""
    by_cell = {(row["samples"], row["lod_bias"], row["scene"]): row for row in rows}
    lines = []
    for samples, bias in dict.fromkeys((row["samples"], row["lod_bias"]) for row in rows):
        bias_rows = [by_cell[samples, bias, scene] for scene in _SCENES]
        moire = f"{100 * float(bias_rows[0]['moire']):.1f} %"
        lines.append(
            [
                f"{samples}",
                f"{float(bias):g}",
                moire,
                *(f"{float(row['rmse']):.4f}" for row in bias_rows),
            ]
        )
    scenes = [scene.replace("_", " ") for scene in _SCENES]
    return report.table(["samples", "lod_bias", "moire", *scenes], lines)


def bytes_table(pyramids: dict[str, dict[str, int]]) -> str:
    """Memory of each scene's texture, as float32 RGB."""
    lines = [
        [
            name.replace("_", " "),
            f"{size['height']} x {size['width']}",
            f"{size['base']:,}",
            f"{size['pyramid']:,}",
            f"{size['pyramid'] / size['base']:.3f}",
        ]
        for name, size in pyramids.items()
    ]
    return report.table(["scene", "texels", "base, bytes", "pyramid, bytes", "ratio"], lines)


def machine_line(run: dict[str, Any]) -> str:
    about = machine.describe(run, seed=f"seed {run['seed']}")
    return (
        f"{about}, {run['size_px']} x {run['size_px']} px; load average at the end "
        f"{run['machine']['load_average_1min']:.1f}; {run['seconds']} s, compilation included."
    )


if __name__ == "__main__":
    publish(HERE / "results", HERE / "README.md")
