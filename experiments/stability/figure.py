"""Make the tables and the figure: `python -m experiments.stability.figure`."""

# pyright: reportMissingImports=false

import json
from pathlib import Path
from typing import Any

from softras2d.plot.library import COLORS

from ..common import machine, report

HERE = Path(__file__).parent


def publish(results: Path, readme: Path) -> None:
    """Write the tables into `readme`, and the figure beside the results."""
    cases, attributes, shifts, sums, degenerate = (
        report.read_csv(results / f"{name}.csv")
        for name in ("cases", "attributes", "shifts", "long_sums", "degenerate")
    )
    run = json.loads((results / "run.json").read_text())
    report.fill_markers(readme, "cases", report.table(*case_table(cases)))
    report.fill_markers(readme, "attributes", report.table(*case_table(attributes)))
    report.fill_markers(readme, "degenerate", report.table(*_degenerate_table(degenerate)))
    report.fill_markers(readme, "shifts", report.table(*_shift_table(shifts)))
    long = [[r["mode"], _short(r["by_color"]), _short(r["by_positions"])] for r in sums]
    report.fill_markers(readme, "sums", report.table(["mode", "colour", "positions"], long))
    about = machine.describe(run, seed=f"seed {run['seed']}")
    report.fill_markers(readme, "machine", f"{about}; {run['seconds']} s.")
    _draw(shifts, results / "shifts.png")


def case_table(rows: list[dict[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Header and lines of the table of cases; cells are `image; worst product`, for each mode."""
    modes = list(dict.fromkeys(r["mode"] for r in rows))
    lines = []
    for name in dict.fromkeys(r["case"] for r in rows):
        by_mode = {r["mode"]: r for r in rows if r["case"] == name}
        stated = next(iter(by_mode.values()))
        limits = f"{_short(stated['stated_value'])}; {_short(stated['stated_product'])}"
        lines.append([name, limits, *(_cell(by_mode.get(mode)) for mode in modes)])
    return ["case", "stated error", *modes], lines


def _degenerate_table(rows: list[dict[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Header and lines, one per kind; cells: `jvp - vjp; largest entry`, worst of all widths."""
    modes, lines = list(dict.fromkeys(r["mode"] for r in rows)), []
    for name in dict.fromkeys(r["case"] for r in rows):
        line = [name]
        for mode in modes:
            of_kind = [r for r in rows if r["case"] == name and r["mode"] == mode]
            if not of_kind:
                line.append("")
                continue
            worst = [max(float(r[key]) for r in of_kind) for key in ("jvp_vjp", "largest")]
            text = f"{_short(worst[0])}; {worst[1]:.2f}"
            line.append(text if all(r["within"] == "yes" for r in of_kind) else f"**{text}**")
        lines.append(line)
    return ["kind", *modes], lines


def _cell(row: dict[str, Any] | None) -> str:
    if row is None:
        return ""
    worst = max(float(row[key]) for key in ("gradient", "jvp", "gauss_newton"))
    text = f"{_short(row['value'])}; {_short(worst)}"
    return text if row["within"] == "yes" else f"**{text}**"


def _shift_table(rows: list[dict[str, Any]]) -> tuple[list[str], list[list[str]]]:
    modes = list(dict.fromkeys(r["mode"] for r in rows))
    lines = []
    for shift in dict.fromkeys(r["shift_px"] for r in rows):
        of_shift = [r for r in rows if r["shift_px"] == shift]
        cells = [f"{_short(r['value'])}; {_short(r['gradient'])}" for r in of_shift]
        same = "same" if all(r["same_bits_on_grid"] == "True" for r in of_shift) else "differ"
        lines.append([f"{int(shift):,}", same, *cells])
    return ["moved by, px", "bits on the grid", *modes], lines


def _short(value: Any) -> str:
    return f"{float(value):.0e}".replace("e-0", "e-").replace("e+00", "")


_MARKERS = "osD^v"


def _draw(rows: list[dict[str, Any]], path: Path) -> None:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10, 4), sharex=True)
    shifts = list(dict.fromkeys(int(r["shift_px"]) for r in rows))
    modes = list(dict.fromkeys(r["mode"] for r in rows))
    for axis, key in zip(axes, ("value", "gradient"), strict=True):
        # Open markers, so that equal values of several modes stay visible.
        for mode, marker, color in zip(modes, _MARKERS, COLORS, strict=False):
            errors = [float(r[key]) for r in rows if r["mode"] == mode]
            axis.plot(shifts, errors, marker=marker, color=color, fillstyle="none", label=mode)
        rounding = [shift * 2.0**-23 for shift in shifts]
        axis.plot(shifts, rounding, "k:", label="one rounding of a coordinate")
        axis.set_xscale("symlog", linthresh=1.0)
        axis.set_yscale("symlog", linthresh=1e-9)
        axis.set(xlabel="scene and origin moved by (px)", ylim=(-2e-10, None))
        axis.set(title=f"the {key}", ylabel="error over the greatest true number")
        axis.grid(alpha=0.3)
    axes[0].legend(fontsize=8, loc="center right")
    figure.tight_layout()
    report.save_figure(figure, path)
    plt.close(figure)


if __name__ == "__main__":
    publish(HERE / "results", HERE / "README.md")
