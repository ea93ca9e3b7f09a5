"""Plot error against time on one scene, and time against the number of triangles."""

# pyright: reportMissingImports=false

from typing import Any

import matplotlib

matplotlib.use("Agg")

from matplotlib import pyplot
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from ..common.scenes import COUNTS
from .times import Entry, Times

# Colours that colour-blind readers can distinguish: Okabe and Ito, *Color Universal Design* (2008).
COLORS = {
    "softras2d": "#D55E00",
    "scanline": "#0072B2",
    "scalar loop": "#000000",
    "Skia": "#009E73",
    "Blend2D": "#CC79A7",
    "Cairo": "#E69F00",
    "OpenCV": "#56B4E9",
}
MARKERS = {
    "softras2d": "o",
    "scanline": "s",
    "scalar loop": "D",
    "Skia": "^",
    "Blend2D": "v",
    "Cairo": "P",
    "OpenCV": "X",
}
_SHORT = {
    "anti-aliased": "AA",
    "4x4 canvas": "4x4",
    "4x4 canvas, anti-aliased": "4x4 AA",
    "1 sample": "1",
}
# Offset of a label from its marker in points: Cairo's would overlap Skia's.
_OFFSETS = {"Cairo": (5, -10), "scanline": (-12, -11)}


def draw(times: Times) -> Figure:
    """Both panels, for flat opaque triangles at 512 px."""
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(13, 5.6), layout="constrained")
    _error_against_time(left, times)
    _time_against_count(right, times)
    return figure


def _error_against_time(axes: Any, times: Times) -> None:
    entries = [e for e in times.scene("flat", 1000, 512) if e.rmse is not None]
    for family, color in COLORS.items():
        family_entries = [e for e in entries if e.family == family]
        if not family_entries:
            continue
        if family in ("scanline", "scalar loop"):
            family_entries = [e for e in family_entries if e.threads == 1]
        joined = family in ("softras2d", "scanline", "scalar loop")
        axes.plot(
            [e.median_ms for e in family_entries],
            [e.rmse for e in family_entries],
            marker=MARKERS[family],
            linestyle="-" if joined else "none",
            linewidth=1,
            color=color,
            label=_family_label(family, family_entries),
        )
        for entry in family_entries:
            text = _SHORT.get(entry.sampling, entry.sampling.split()[0])
            axes.annotate(
                text if joined else f"{family} {text}",
                (entry.median_ms, entry.rmse),
                xytext=_OFFSETS.get(family, (5, 4)),
                textcoords="offset points",
                fontsize=8,
                color=color,
            )
    axes.set(xscale="log", yscale="log", xlabel="median time (ms)")
    axes.set_ylabel("RMSE to 32x32 samples")
    axes.set_title("1,000 flat opaque triangles, 512 x 512 px")
    axes.grid(alpha=0.3)
    axes.margins(x=0.15)
    axes.legend(fontsize=8, loc="upper right")
    _plain_milliseconds(axes.xaxis)


def _time_against_count(axes: Any, times: Times) -> None:
    for family, color in COLORS.items():
        sampling = (
            "16 samples" if family in ("softras2d", "scanline", "scalar loop") else "4x4 canvas"
        )
        for parallel in (False, True):
            line = [
                entry
                for count in COUNTS
                if (entry := times.find(family, sampling, triangles=count, parallel=parallel))
            ]
            if line:
                axes.plot(
                    [entry.triangles for entry in line],
                    [entry.median_ms for entry in line],
                    marker=MARKERS[family],
                    linestyle="-" if line[0].threads == 1 else "--",
                    linewidth=2 if family == "softras2d" else 1,
                    color=color,
                    label=line[0].label,
                )
    axes.set(xscale="log", yscale="log", xlabel="triangles", ylabel="median time (ms)")
    axes.set_title("16 samples per pixel, flat opaque, 512 x 512 px")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="lower right")
    axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
    _plain_milliseconds(axes.yaxis)


def _family_label(family: str, entries: list[Entry]) -> str:
    several = entries and entries[0].threads > 1
    return f"{family}, {entries[0].threads} threads" if several else family


def _plain_milliseconds(axis: Any) -> None:
    """Label 1, 2, 5, 10, ... rather than powers of ten."""
    axis.set_major_locator(LogLocator(10, subs=(1, 2, 5)))
    axis.set_major_formatter(StrMethodFormatter("{x:g}"))
    axis.set_minor_formatter(NullFormatter())
