"""Plot error against time, with a panel for each class of scene and a label at every point."""

# pyright: reportMissingImports=false

from collections.abc import Sequence
from typing import Any

import matplotlib

matplotlib.use("Agg")

from matplotlib import pyplot
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogFormatterSciNotation, LogLocator, NullFormatter, StrMethodFormatter

from ..common import labels
from .points import Point, front

# Colours that colour-blind readers can distinguish: Okabe and Ito, *Color Universal Design* (2008).
# Soft and Cairo, and DEODR and the loop, also differ by their markers.
STYLES: dict[str, tuple[str, str, Any]] = {
    "Hard": ("#D55E00", "o", "-"),
    "Hard, pixel shading": ("#D55E00", "d", "none"),
    "Soft": ("#B07800", "s", "-"),
    "Area": ("#0072B2", "D", "none"),
    "compiled scanline": ("#000000", "h", "-"),
    "Skia": ("#009E73", "^", "none"),
    "Blend2D": ("#CC79A7", "v", "none"),
    "Cairo": ("#3A8FC0", "P", "none"),
    "OpenCV": ("#777777", "X", "none"),
    "DEODR": ("#000000", "*", "none"),
}
_FONT = 8.5

_EARLIER = "#BDBDBD"
"""Colour of the points of an earlier version."""


def draw(
    points: Sequence[Point],
    earlier: Sequence[Point],
    version: str,
    titles: dict[str, str],
    time_label: str,
    error: str,
    note: str,
) -> Figure:
    """Draw one panel for each scene of `titles`, and the legend in a separate panel.

    - `earlier`, `version`: points of an earlier version of softras2d, drawn in grey, and its name.
    - `time_label`, `error`: names of the axes.
    - `note`: text below the legend.
    """
    columns = 2
    lines = -(-(len(titles) + 1) // columns)
    figure, grid = pyplot.subplots(
        lines, columns, figsize=(6.2 * columns, 4.8 * lines), squeeze=False, layout="constrained"
    )
    panels = list(grid.flat)
    for axes, (scene, title) in zip(panels, titles.items(), strict=False):
        _panel(
            axes,
            [point for point in points if point.scene == scene],
            [point for point in earlier if point.scene == scene],
        )
        axes.set_title(title)
        axes.set(xlabel=time_label, ylabel=error)
    for axes in panels[len(titles) :]:
        axes.axis("off")
    _key(panels[len(titles)], points, note, version if earlier else None)
    # Labels are placed in pixels, so the layout must not change afterwards.
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for axes, scene in zip(panels, titles, strict=False):
        of_scene = [point for point in points if point.scene == scene]
        texts = [labels.Label(p.ms, p.error, _text(p), STYLES[p.family][0]) for p in of_scene]
        clashes = labels.place(axes, texts, _FONT, _joined(of_scene))
        if clashes:
            print(f"{scene}: {clashes} labels overlap a label or a point")
    return figure


def _panel(axes: Any, points: Sequence[Point], earlier: Sequence[Point]) -> None:
    best = front(points)
    _plot_earlier(axes, earlier)
    axes.plot(
        [point.ms for point in best],
        [point.error for point in best],
        drawstyle="steps-post", color="#F0E442", linewidth=6, alpha=0.8, zorder=0,
    )  # fmt: skip
    for family, (color, marker, line) in STYLES.items():
        for filtered in (False, True):
            of_family = [p for p in points if p.family == family and ("mip" in p.label) == filtered]
            joined = line != "none" and len(of_family) > 1 and not filtered
            axes.plot(
                [point.ms for point in of_family],
                [point.error for point in of_family],
                color=color, marker=marker, linestyle=line if joined else "none",
                linewidth=0.8, markersize=6, zorder=3,
                markerfacecolor="white" if filtered else color,
            )  # fmt: skip
    axes.set(xscale="log", yscale="log")
    axes.margins(x=0.12, y=0.12)
    axes.grid(alpha=0.25)
    axes.xaxis.set_major_locator(LogLocator(10, subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    low, high = axes.get_ylim()
    few = high / low < 30
    axes.yaxis.set_major_locator(LogLocator(10, subs=(1, 2, 5) if few else (1,)))
    axes.yaxis.set_major_formatter(
        StrMethodFormatter("{x:g}") if few else LogFormatterSciNotation()
    )
    axes.yaxis.set_minor_formatter(NullFormatter())


def _plot_earlier(axes: Any, points: Sequence[Point]) -> None:
    """Plot the points of an earlier version in grey, with the markers of their families."""
    for family, (_, marker, line) in STYLES.items():
        of_family = [point for point in points if point.family == family]
        # Modes with different filters are not points of one curve.
        is_joined = line != "none" and not any("mip" in point.label for point in of_family)
        axes.plot(
            [point.ms for point in of_family],
            [point.error for point in of_family],
            color=_EARLIER, marker=marker, linestyle=line if is_joined else "none",
            linewidth=0.8, markersize=5, zorder=1,
        )  # fmt: skip


def _joined(points: Sequence[Point]) -> list[list[tuple[float, float]]]:
    """The lines that join a family's points."""
    return [
        [(p.ms, p.error) for p in points if p.family == family and "mip" not in p.label]
        for family, (_, _, line) in STYLES.items()
        if line != "none" and any(p.family == family and "mip" not in p.label for p in points)
    ]


def _text(point: Point) -> str:
    """The label of a point, with the family's name if no line joins the points of the family."""
    joined = STYLES[point.family][2] == "-"
    if point.family == "Hard, pixel shading":
        return f"{point.label}, pixel"
    return point.label if joined else f"{point.family} {point.label}"


def _key(axes: Any, points: Sequence[Point], note: str, version: str | None) -> None:
    families = {point.family for point in points}
    handles = [
        Line2D(
            [],
            [],
            color=color,
            marker=marker,
            linestyle=line,
            label=_family(family),
            markerfacecolor="white" if family == "Hard, pixel shading" else color,
        )
        for family, (color, marker, line) in STYLES.items()
        if family in families
    ]
    handles.append(Line2D([], [], color="#F0E442", linewidth=6, alpha=0.8, label="Pareto front"))
    if version is not None:
        handles.append(Line2D([], [], color=_EARLIER, marker="o", label=f"softras2d, {version}"))
    axes.legend(handles=handles, loc="upper left", fontsize=10, frameon=False)
    axes.text(0.02, 0.02, note, transform=axes.transAxes, fontsize=10, va="bottom", wrap=False)


def _family(family: str) -> str:
    about = {
        "Hard": "softras2d Hard: samples per pixel",
        "Hard, pixel shading": "softras2d Hard, pixel shading: samples",
        "Soft": "softras2d Soft: width",
        "Area": "softras2d Area: compositing",
        "compiled scanline": "compiled scanline (numba): samples per pixel",
        "DEODR": "DEODR: canvas a side",
    }
    return about.get(family, family)
