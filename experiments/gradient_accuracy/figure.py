"""Make the tables and the figure: `python -m experiments.gradient_accuracy.figure`."""

# pyright: reportMissingImports=false

import json
from pathlib import Path
from typing import Any

from ..common import machine, report
from ..common.labels import Label, place

HERE = Path(__file__).parent


def publish(results: Path, readme: Path) -> None:
    """Write the tables into `readme`, and the figure beside the results."""
    rows = report.read_csv(results / "gradients.csv")
    run = json.loads((results / "run.json").read_text())
    cells = list(dict.fromkeys((r["scene"], r["triangles"], r["target"]) for r in rows))
    report.fill_markers(readme, "gradients", "\n\n".join(_table(rows, cell) for cell in cells))
    about = machine.describe(run, seed=f"seed {run['seed']}")
    report.fill_markers(readme, "machine", f"{about}.")
    _draw(rows, results / "gradients.png")


def _table(rows: list[dict[str, Any]], cell: tuple[str, str, str]) -> str:
    scene, triangles, target = cell
    cell_rows = [r for r in rows if (r["scene"], r["triangles"], r["target"]) == cell]
    header = ["mode", "cosine", "relative error", "cosine, colours", "forward, ms",
              "forward + backward, ms", "tangent, ms", "time / DEODR", "first call, s"]  # fmt: skip
    lines = [
        [r["mode"], r["cosine"], r["relative_error"], r["color_cosine"]]
        + [
            _short(r[key])
            for key in ("forward_ms", "gradient_ms", "tangent_ms", "over_deodr", "first_call_s")
        ]
        for r in cell_rows
    ]
    title = f"**{scene}, {int(triangles):,} triangles, {target}**"
    return f"{title}\n\n{report.table(header, lines)}"


def _short(value: str) -> str:
    return f"{float(value):.3g}" if value else ""


COLORS = {"hard": "#0072B2", "soft": "#E69F00", "area": "#009E73", "DEODR": "#000000"}
"""Colours by Okabe and Ito, which colour-blind readers can distinguish."""


def _draw(rows: list[dict[str, Any]], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.ticker import NullFormatter

    counts = list(dict.fromkeys(r["triangles"] for r in rows))
    figure, axes = plt.subplots(
        1, len(counts), figsize=(5.4 * len(counts), 5), squeeze=False, layout="constrained"
    )
    labels: list[list[Label]] = []
    for axis, count in zip(axes[0], counts, strict=True):
        points = [
            Label(
                float(r["gradient_ms"]),
                1 - float(r["cosine"]),
                r["mode"],
                COLORS[r["mode"].split(",")[0]],
            )
            for r in rows
            if (r["triangles"], r["scene"], r["target"]) == (count, "flat", "white noise")
        ]
        axis.scatter(
            [p.x for p in points], [p.y for p in points], color=[p.color for p in points], s=25
        )
        axis.set(xscale="log", yscale="log", xlabel="forward + backward (ms)",
                 title=f"{int(count):,} flat triangles, white noise")  # fmt: skip
        axis.margins(0.25)
        # Labels at decades alone would be too few, and labels between them would overlap.
        axis.xaxis.set_minor_formatter(NullFormatter())
        low, high = axis.get_xlim()
        ticks = [ms for ms in (5, 10, 20, 50, 100, 200, 500, 1000, 2000) if low < ms < high]
        axis.set_xticks(ticks, [str(ms) for ms in ticks])
        axis.grid(alpha=0.3)
        labels.append(points)
    axes[0][0].set_ylabel("1 - cosine to the exact position gradient")
    figure.canvas.draw()
    for axis, points in zip(axes[0], labels, strict=True):
        place(axis, points, fontsize=8)
    report.save_figure(figure, path)
    plt.close(figure)


if __name__ == "__main__":
    publish(HERE / "results", HERE / "README.md")
