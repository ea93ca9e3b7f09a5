"""Make the table and the figure: `python -m experiments.fit_solvers.figure`."""

import json
from pathlib import Path
from typing import Any

from ..common import machine, report

HERE = Path(__file__).parent


def publish(results: Path, readme: Path) -> None:
    """Write the table into `readme`, and the figure beside the results."""
    rows = report.read_csv(results / "solvers.csv")
    run = json.loads((results / "run.json").read_text())
    report.fill_markers(readme, "solvers", _table(rows))
    about = machine.describe(run, seed="seed 0")
    report.fill_markers(readme, "machine", f"{about}; {run['seconds'] / 60:.0f} minutes.")
    _draw(rows, results / "solvers.png")


def _runs(rows: list[dict[str, Any]]) -> dict[tuple[str, str], list[dict[str, Any]]]:
    runs: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in rows:
        runs.setdefault((row["subject"], row["solver"]), []).append(row)
    return runs


def _table(rows: list[dict[str, Any]]) -> str:
    header = ["start", "solver", "steps", "seconds per step", "at the start, dB", "at the end, dB"]
    lines = []
    for (subject, solver), run in _runs(rows).items():
        first, last = run[0], run[-1]
        steps = int(last["steps"]) - int(first["steps"])
        pace = float(last["seconds"]) / max(steps, 1)
        lines.append(
            [subject, f"`{solver}`", last["steps"], f"{pace:.3f}"]
            + [f"{float(row['psnr']):.2f}" for row in (first, last)]
        )
    return report.table(header, lines)


def _draw(rows: list[dict[str, Any]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    runs = _runs(rows)
    subjects = list(dict.fromkeys(subject for subject, _ in runs))
    figure, axes = plt.subplots(
        2, len(subjects), figsize=(4 * len(subjects), 6.4), squeeze=False, layout="constrained"
    )
    for (subject, solver), run in runs.items():
        column = subjects.index(subject)
        decibels = [float(row["psnr"]) for row in run]
        for line, axis in enumerate(("seconds", "steps")):
            x = [float(row[axis]) for row in run]
            axes[line][column].plot(x, decibels, label=solver)
        axes[0][column].set_title(subject)
    for line, axis in enumerate(("seconds, without compiling", "steps")):
        for panel in axes[line]:
            panel.set_xlabel(axis)
            panel.set_ylabel("PSNR, dB")
            panel.grid(alpha=0.3)
            if line == 1:
                panel.set_xscale("symlog", linthresh=1)
    axes[0][-1].legend(loc="lower right")
    figure.savefig(path, dpi=110)
    plt.close(figure)


if __name__ == "__main__":
    publish(HERE / "results", HERE / "README.md")
