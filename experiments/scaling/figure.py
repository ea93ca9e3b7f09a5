"""Make figures and tables from the stored results: `python -m experiments.scaling.figure`."""

# pyright: reportMissingImports=false

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

from matplotlib import pyplot
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ..common import machine, report
from .cases import AXES, QUICK
from .exponents import Fit, fit
from .growth import WHAT
from .visits import COUNTED, OURS, YARDSTICK

HERE = Path(__file__).parent
# Colours that colour-blind readers can distinguish: Okabe and Ito, *Color Universal Design* (2008).
COLORS = {"image": "#0072B2", "gradient": "#D55E00"}
MARKERS = {"image": "o", "gradient": "s"}
COSTS = {"time": ("least_ms", "least time a call (ms)"), "memory": ("memory_mib", "memory (MiB)")}
LABELS = {axis.name: axis.label for axis in (*QUICK, *AXES)}

Row = dict[str, Any]


def publish(results: Path, readme: Path | None) -> None:
    """Draw both figures beside the results, and put the tables into `readme` (None: print them)."""
    growth, memory, ways = (
        report.read_csv(results / f"{name}.csv") for name in ("growth", "memory", "traversal")
    )
    run = json.loads((results / "run.json").read_text())
    for figure, name in ((draw_growth(growth), "growth"), (draw_ways(ways), "traversal")):
        for suffix in ("png", "svg"):
            report.save_figure(figure, results / f"{name}.{suffix}")
        pyplot.close(figure)
    about = machine.describe(run, seed=run["seed"])
    texts = {
        "exponents": exponents_table(growth),
        "left-out": left_out(growth),
        "memory": memory_table(memory),
        "traversal": ways_tables(ways),
        "machine": f"{about}; {run['seconds'] / 60:.0f} minutes.",
    }
    report.fill_or_print(readme, texts)


def series(rows: list[Row], axis: str, what: str, cost: str) -> tuple[list[float], list[float]]:
    """The measured sizes and costs."""
    key = COSTS[cost][0]
    measured = [r for r in rows if (r["axis"], r["what"]) == (axis, what) and r[key]]
    return [float(r["size"]) for r in measured], [float(r[key]) for r in measured]


def axes_of(rows: list[Row]) -> list[str]:
    return list(dict.fromkeys(r["axis"] for r in rows))


def draw_growth(rows: list[Row]) -> Figure:
    """Draw panels of time above panels of memory, three axes in a row."""
    names = axes_of(rows)
    across = min(3, len(names))
    blocks = -(-len(names) // across)
    figure, grid = pyplot.subplots(
        2 * blocks, across, figsize=(3.9 * across, 5.8 * blocks), layout="constrained",
        squeeze=False,
    )  # fmt: skip
    for index, name in enumerate(names):
        for lower, cost in enumerate(COSTS):
            axes = grid[2 * (index // across) + lower][index % across]
            _draw_growth(axes, rows, name, cost)
            axes.set_title(name if lower == 0 else "")
            if index % across == 0:
                axes.set_ylabel(COSTS[cost][1])
    for axes in grid.flat[2 * len(names) :] if len(names) % across else ():
        axes.set_visible(False)
    return figure


def _draw_growth(axes: Any, rows: list[Row], name: str, cost: str) -> None:
    for what in WHAT:
        sizes, costs = series(rows, name, what, cost)
        fitted = fit(sizes, costs)
        label = what if fitted is None else f"{what}: {fitted}"
        axes.plot(sizes, costs, MARKERS[what], color=COLORS[what], markersize=5, label=label)
        axes.plot(sizes, costs, color=COLORS[what], linewidth=0.6)
        if fitted is not None:
            ends = [fitted.first, fitted.last]
            axes.plot(ends, [_fitted(fitted, size) for size in ends], color="black", linewidth=1.2)
    axes.set(xscale="log", yscale="log", xlabel=LABELS[name])
    low, high = axes.get_ylim()
    # Leave space for the legend above the lines. Show at least a decade, so that slopes compare.
    high = max(high, 10 * low)
    axes.set_ylim(low, high * (high / low) ** 0.35)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8.5, loc="upper left", title="exponent", title_fontsize=8.5)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_locator(LogLocator(10, numticks=8))
        axis.set_major_formatter(FuncFormatter(_plain))
        axis.set_minor_formatter(NullFormatter())
    if max(series(rows, name, WHAT[0], cost)[0], default=1) < 1e5:
        sizes = series(rows, name, WHAT[0], cost)[0]
        axes.set_xticks(sizes, [_plain(size, 0) for size in sizes], rotation=30)


def _fitted(law: Fit, size: float) -> float:
    return law.scale * size**law.exponent


def _plain(value: float, _: Any) -> str:
    return f"{value / 1e6:g}M" if value >= 1e6 else f"{value:,.10g}"


def draw_ways(rows: list[Row]) -> Figure:
    """A panel of bars per scene: time to compute visible triangles, and time to average colours."""
    scenes = list(dict.fromkeys(r["scene"] for r in rows))
    ways = list(dict.fromkeys(r["way"] for r in rows))
    figure, grid = pyplot.subplots(
        1, len(scenes), figsize=(4.6 * len(scenes), 4.4), layout="constrained", sharey=True,
        squeeze=False,
    )  # fmt: skip
    for axes, scene in zip(grid[0], scenes, strict=True):
        by_way = {r["way"]: r for r in rows if r["scene"] == scene}
        positions = range(len(ways))
        find = [float(by_way[way]["find_ms"]) for way in ways]
        resolve = [float(by_way[way]["resolve_ms"]) for way in ways]
        at_once = [way in (COUNTED, OURS) for way in ways]
        colors = ["#D55E00" if way == OURS else "#0072B2" for way in ways]
        hatch = ["//" if is_at_once else "" for is_at_once in at_once]
        axes.barh(positions, find, color=colors, hatch=hatch, edgecolor="white", label="_")
        axes.barh(positions, resolve, left=find, color="#BBBBBB")
        for y, (a, b) in enumerate(zip(find, resolve, strict=True)):
            axes.text(a + b, y, f" {a + b:.3g}", va="center", fontsize=8.5)
        axes.set(xlabel="median time (ms)", title=_scene_title(scene, by_way[YARDSTICK]))
        axes.title.set_fontsize(10)
        axes.margins(x=0.14)
        axes.grid(axis="x", alpha=0.3)
        axes.set_axisbelow(True)
    grid[0][0].set_yticks(range(len(ways)), [_way_label(way) for way in ways])
    grid[0][0].invert_yaxis()
    figure.legend(handles=list(_key()), loc="outside lower center", ncols=4, fontsize=9)
    return figure


def _key() -> Iterable[Any]:
    from matplotlib.patches import Patch

    yield Patch(facecolor="#0072B2", label="find what shows, 1 thread")
    yield Patch(facecolor="#BBBBBB", label="then average the samples")
    yield Patch(facecolor="#0072B2", edgecolor="white", hatch="//", label="both at once, 1 thread")
    yield Patch(facecolor="#D55E00", edgecolor="white", hatch="//", label="both at once, all cores")


def _way_label(way: str) -> str:
    return "softras2d (all cores)" if way == OURS else way


def _scene_title(scene: str, row: Row) -> str:
    return f"{int(row['triangles']):,} {scene}, {row['size_px']} px, 16 samples"


def exponents_table(rows: list[Row]) -> str:
    """For each axis, image and gradient: both ends of the range, and the fitted exponents."""
    lines = []
    for name in axes_of(rows):
        for what in WHAT:
            sizes, times = series(rows, name, what, "time")
            memory_sizes, memories = series(rows, name, what, "memory")
            if not sizes or not memories:
                continue
            lines.append(
                [
                    f"{LABELS[name]}, {what}",
                    f"{_plain(sizes[0], 0)} to {_plain(sizes[-1], 0)}",
                    f"{_three(times[0])} to {_three(times[-1])}",
                    str(fit(sizes, times) or ""),
                    f"{_three(memories[0])} to {_three(memories[-1])}",
                    str(fit(memory_sizes, memories) or ""),
                ]
            )
    header = ["cost against", "range", "ms", "exponent of time", "MiB", "exponent of memory"]
    return report.table(header, lines)


def left_out(rows: list[Row]) -> str:
    """A sentence for each case that was left out."""
    missing = [r for r in rows if r["left_out"]]
    if not missing:
        return "No case was left out: each needed less than 16 GiB and less than a minute per call."
    return "\n".join(
        f"- Left out: {LABELS[r['axis']]} {_plain(float(r['size']), 0)}, {r['what']}: "
        f"{r['left_out']}"
        + (f" ({float(r['memory_mib']) / 1024:.1f} GiB)." if r["memory_mib"] else ".")
        for r in missing
    )


def memory_table(rows: list[Row]) -> str:
    """Memory by the compiler's analysis, and the growth of a fresh process."""
    lines = []
    for r in rows:
        laid_out = float(r["program_mib"]) - float(r["arguments_mib"])
        lines.append(
            [
                f"{r['what']}: {int(r['triangles']):,} triangles, {r['size_px']} px, "
                f"{r['samples']} samples, batch {r['batch']}",
                f"{laid_out:,.0f}",
                f"{float(r['grown_mib']):,.0f}",
                f"{float(r['grown_mib']) / laid_out:.2f}",
                f"{float(r['imported_mib']):,.0f}",
                f"{float(r['process_mib']):,.0f}",
            ]
        )
    header = [
        "one call",
        "compiler's figure, MiB",
        "growth, MiB",
        "growth / figure",
        "after imports, MiB",
        "peak of the process, MiB",
    ]
    return report.table(header, lines)


def ways_tables(rows: list[Row]) -> str:
    """For each scene, times and their ratio to the bounding box by rows."""
    sections = []
    for scene in dict.fromkeys(r["scene"] for r in rows):
        scene_rows = [r for r in rows if r["scene"] == scene]
        base = next(r for r in scene_rows if r["way"] == YARDSTICK)
        base_ms = float(base["find_ms"]) + float(base["resolve_ms"])
        lines = []
        for r in scene_rows:
            find, resolve = float(r["find_ms"]), float(r["resolve_ms"])
            alone = r["way"] not in (COUNTED, OURS)
            lines.append(
                [
                    _way_label(r["way"]),
                    _three(find) if alone else "",
                    f"{find / float(base['find_ms']):.2f}" if alone else "",
                    _three(find + resolve),
                    f"{(find + resolve) / base_ms:.2f}",
                    _three(float(r["cpu_ms"]) + resolve),
                ]
            )
        header = ["method", "visibility, ms", "visibility / box by rows", "image, ms",
                  "image / box by rows", "processor ms"]  # fmt: skip
        boxed, covered, shown = (float(base[key]) for key in ("boxed", "covered", "shown"))
        set_up = float(base["set_up_ms"])
        sections.append(
            f"**{_scene_title(scene, base)}**: {boxed / 1e6:,.1f} million samples in bounding "
            f"boxes, {covered / 1e6:,.2f} million covered ({100 * covered / boxed:.1f} %), "
            f"{shown / 1e6:,.2f} million shown. Edges and boxes take {_three(set_up)} ms of each "
            f"loop.\n\n{report.table(header, lines)}"
        )
    return "\n\n".join(sections)


def _three(value: float) -> str:
    """Three significant digits, without an exponent."""
    return f"{value:,.0f}" if value >= 100 else f"{value:.3g}"


if __name__ == "__main__":
    publish(HERE / "results", HERE / "README.md")
