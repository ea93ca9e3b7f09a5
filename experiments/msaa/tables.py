"""The tables, made from the stored results.

python -m experiments.msaa.tables
"""

import csv
import json
from pathlib import Path
from typing import Any

from ..common import report

HERE = Path(__file__).parent


def publish(results: Path, readme: Path | None) -> None:
    """Put the tables into `readme` (None: print them)."""
    run = json.loads((results / "run.json").read_text())
    texts = {
        "methods": methods_table(_load(results / "methods.csv")),
        "times": times_table(_load(results / "times.csv")),
        "machine": machine_line(run),
    }
    for name, text in texts.items():
        if readme is None:
            print(f"\n{text}")
        else:
            report.fill_markers(readme, name, text)


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
    columns = ("RMSE", "wrong pixels", "colours a pixel")
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
    header = ["scene, method", "median ms", "least ms", "median over flat", "least over flat"]
    return report.table(header, lines)


def machine_line(run: dict[str, Any]) -> str:
    on = run["machine"]
    packages = ", ".join(f"{name} {got}" for name, got in on["packages"].items() if got)
    size = f"{run['size_px']} x {run['size_px']} px"
    return (
        f"{on['date']}: {on['processor']}, {on['cores']} cores, {on['memory_gib']} GiB, "
        f"{on['system'].split('-')[0]}, Python {on['python']}; {packages}; no seed, as nothing is "
        f"drawn by chance; {run['precision']}, {size}; load average at the end "
        f"{on['load_average_1min']:.1f}; {run['seconds']} s."
    )


def _load(path: Path) -> list[dict[str, Any]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


if __name__ == "__main__":
    publish(HERE / "results", HERE / "README.md")
