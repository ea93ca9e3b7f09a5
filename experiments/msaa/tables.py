"""Make the tables from the stored results.

python -m experiments.msaa.tables
"""

import json
from pathlib import Path
from typing import Any

from ..common import machine, report

HERE = Path(__file__).parent


def publish(results: Path, readme: Path | None) -> None:
    """Put the tables into `readme` (None: print them)."""
    run = json.loads((results / "run.json").read_text())
    texts = {
        "methods": methods_table(report.read_csv(results / "methods.csv")),
        "times": times_table(report.read_csv(results / "times.csv")),
        "machine": machine_line(run),
    }
    report.fill_or_print(readme, texts)


def methods_table(rows: list[dict[str, Any]]) -> str:
    """One row for each scene and method; columns for each number of samples."""
    counts = list(dict.fromkeys(row["samples"] for row in rows))
    found = {(row["scene"], row["method"], row["samples"]): row for row in rows}
    lines = []
    for scene, method in dict.fromkeys((row["scene"], row["method"]) for row in rows):
        cells = []
        for count in counts:
            row = found[scene, method, count]
            wrong = row["wrong"] and f"{100 * float(row['wrong']):.2f} %"
            cells += [f"{float(row['rmse']):.4f}", wrong, f"{float(row['shaded']):.2f}"]
        lines.append([f"{scene}, {method}", *cells])
    columns = ("RMSE", "wrong pixels", "colours per pixel")
    header = [f"{count} samples: {column}" for count in counts for column in columns]
    return report.table(["scene, method", *header], lines)


def times_table(rows: list[dict[str, Any]]) -> str:
    """Milliseconds, and the ratio to the same triangles in flat colours."""
    lines = [
        [
            f"{row['scene']}, {row['method']}",
            f"{float(row['median_ms']):.1f}",
            f"{float(row['least_ms']):.1f}",
            f"{float(row['median_over_flat']):.2f}",
            f"{float(row['least_over_flat']):.2f}",
        ]
        for row in rows
    ]
    header = ["scene, method", "median ms", "least ms", "median / flat", "least / flat"]
    return report.table(header, lines)


def machine_line(run: dict[str, Any]) -> str:
    seed = "no seed, as nothing is drawn by chance"
    return (
        f"{machine.describe(run, seed=seed)}, {run['size_px']} x {run['size_px']} px; load average "
        f"at the end {run['machine']['load_average_1min']:.1f}; {run['seconds']} s."
    )


if __name__ == "__main__":
    publish(HERE / "results", HERE / "README.md")
