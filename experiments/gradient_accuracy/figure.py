"""The tables and the figure: `python -m experiments.gradient_accuracy.figure`."""

# pyright: reportMissingImports=false

import json
from pathlib import Path
from typing import Any

from ..common import machine, report

HERE = Path(__file__).parent


def publish(results: Path, readme: Path) -> None:
    """Write the tables into `readme`, and the figure beside the results."""
    rows = report.read_csv(results / "gradients.csv")
    run = json.loads((results / "run.json").read_text())
    cells = list(dict.fromkeys((r["scene"], r["triangles"], r["target"]) for r in rows))
    report.fill_markers(readme, "gradients", "\n\n".join(_table(rows, cell) for cell in cells))
    about = machine.describe(run, seed=f"seed {run['seed']}")
    report.fill_markers(readme, "machine", f"{about}; {run['seconds'] / 60:.0f} minutes.")
    _draw(rows, results / "gradients.png")


def _table(rows: list[dict[str, Any]], cell: tuple[str, str, str]) -> str:
    scene, triangles, target = cell
    own = [r for r in rows if (r["scene"], r["triangles"], r["target"]) == cell]
    header = ["mode", "cosine", "relative error", "colours", "forward, ms", "forward + backward",
              "tangent", "over DEODR", "first call, s"]  # fmt: skip
    lines = [
        [r["mode"], r["cosine"], r["relative_error"], r["color_cosine"]]
        + [
            _short(r[key])
            for key in ("forward_ms", "gradient_ms", "tangent_ms", "over_deodr", "first_call_s")
        ]
        for r in own
    ]
    title = f"**{scene}, {int(triangles):,} triangles, {target}**"
    return f"{title}\n\n{report.table(header, lines)}"


def _short(value: str) -> str:
    return f"{float(value):.3g}" if value else ""


def _draw(rows: list[dict[str, Any]], path: Path) -> None:
    import matplotlib.pyplot as plt
    from matplotlib.ticker import NullFormatter

    counts = list(dict.fromkeys(r["triangles"] for r in rows))
    figure, axes = plt.subplots(1, len(counts), figsize=(5 * len(counts), 4.5), squeeze=False)
    colors = {"hard": "tab:blue", "soft": "tab:orange", "area": "tab:green", "DEODR": "black"}
    for axis, count in zip(axes[0], counts, strict=True):
        for r in rows:
            if (r["triangles"], r["scene"], r["target"]) != (count, "flat", "white noise"):
                continue
            color = colors[r["mode"].split(",")[0]]
            x, y = float(r["gradient_ms"]), 1 - float(r["cosine"])
            axis.scatter(x, y, color=color, s=25)
            axis.annotate(r["mode"], (x, y), xytext=(4, 3), textcoords="offset points", fontsize=7)
        axis.set(xscale="log", yscale="log", xlabel="forward + backward, ms",
                 title=f"{int(count):,} flat triangles")  # fmt: skip
        # Labels of decades alone would be too few, and those between them overlap.
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.set_xticks(ticks := [20, 50, 100, 200, 500, 1000, 2000], [str(ms) for ms in ticks])
        axis.grid(alpha=0.3)
    axes[0][0].set_ylabel("1 - cosine to the exact position gradient")
    figure.tight_layout()
    report.save_figure(figure, path)
    plt.close(figure)


if __name__ == "__main__":
    publish(HERE / "results", HERE / "README.md")
