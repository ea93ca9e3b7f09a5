"""Draw the contact sheet, a detail of three scenes under each filter, and error against time."""

# pyright: reportMissingImports=false

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")

from matplotlib import pyplot
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

import softras2d as sr
from softras2d.io.contact_sheet import Strip, contact_sheet

from .measures import rmse
from .methods import SAMPLES, Method

DETAILS = {"zone_plate": (155, 235), "ground": (206, 67), "stretched": (98, 180)}
"""Upper left corner (x, y) of the enlarged part of each scene."""
DETAIL_SIDE, ZOOM = 24, 5

FILTERS = (
    ("nearest", "zero", 1),
    ("nearest", "nearest", 1),
    ("nearest", "linear", 1),
    ("bilinear", "zero", 1),
    ("bilinear", "nearest", 1),
    ("bilinear", "linear", 1),
    ("bilinear", "linear", 4),
    ("bilinear", "linear", 16),
)


def write(
    path: Path,
    images: dict[tuple[str, Method], np.ndarray],
    references: dict[str, np.ndarray],
) -> None:
    """Draw a sheet: rows are filters; columns are numbers of samples and the reference."""
    strips = []
    for pixel, level, probes in FILTERS:
        for name, corner in DETAILS.items():
            drawn = [Method(pixel, level, probes, samples) for samples in SAMPLES]
            drawn = [method for method in drawn if (name, method) in images]
            if not drawn:
                continue
            shown = [images[name, method] for method in drawn]
            captions = [
                f"{method.samples}: {rmse(image, references[name]):.3f}"
                for method, image in zip(drawn, shown, strict=True)
            ]
            shown.append(references[name])
            captions.append("reference")
            parts = [_detail(image, corner) for image in shown]
            strips.append(Strip(f"{drawn[0].name}", name, captions, parts))
    sheet = contact_sheet(strips, across=len(DETAILS))
    path.parent.mkdir(parents=True, exist_ok=True)
    sr.write_image(path, sheet)


def _detail(image: np.ndarray, corner: tuple[int, int]) -> np.ndarray:
    x, y = corner
    detail = image[y : y + DETAIL_SIDE, x : x + DETAIL_SIDE].astype(np.float32)
    return detail.repeat(ZOOM, 0).repeat(ZOOM, 1)


# Colours that colour-blind readers can distinguish: Okabe and Ito, *Color Universal Design* (2008).
COLORS = {
    "nearest, level zero": "#000000",
    "nearest, level nearest": "#56B4E9",
    "nearest, level linear": "#0072B2",
    "bilinear, level zero": "#E69F00",
    "bilinear, level nearest": "#CC79A7",
    "bilinear, level linear": "#D55E00",
    "anisotropic, 4 probes": "#7FBF9F",
    "anisotropic, 16 probes": "#009E73",
}


def error_against_time(
    rows: list[dict[str, Any]], biased: list[dict[str, Any]], scenes: tuple[str, ...]
) -> Figure:
    """Draw a panel for each scene; the points of a line are 1, 4 and 16 samples per pixel.

    `biased` has rows of trilinear images whose mip level is lowered to the spacing of the samples.
    """
    figure, panels = pyplot.subplots(
        1, len(scenes), figsize=(9.5, 4.9), layout="constrained", sharey=True
    )
    for axes, name in zip(panels, scenes, strict=True):
        for label, color in COLORS.items():
            measured_rows = [row for row in rows if (row["scene"], row["filter"]) == (name, label)]
            measured_rows = [row for row in measured_rows if row["over_yardstick"]]
            times = [float(row["over_yardstick"]) for row in measured_rows]
            errors = [float(row["rmse"]) for row in measured_rows]
            marker = "s" if label.startswith("nearest") else "o"
            axes.plot(times, errors, marker=marker, linewidth=1.2, color=color, label=label)
            for row, x, y in zip(measured_rows, times, errors, strict=True):
                axes.annotate(
                    row["samples"], (x, y), (4, 4), textcoords="offset points", fontsize=7,
                    color=color,
                )  # fmt: skip
        trilinear = {
            row["samples"]: float(row["over_yardstick"])
            for row in rows
            if (row["scene"], row["filter"]) == (name, "bilinear, level linear")
        }
        measured_rows = [
            row for row in biased if row["scene"] == name and row["samples"] in trilinear
        ]
        # The bias is an array, so that the program and its time are the same.
        times = [trilinear[row["samples"]] for row in measured_rows]
        errors = [float(row["rmse"]) for row in measured_rows]
        label = "bilinear, level linear, biased to the samples"
        axes.plot(times, errors, "o--", linewidth=1.2, color="#D55E00", mfc="white", label=label)
        axes.set(xscale="log", yscale="log", title=name)
        axes.set_xlabel("time over bilinear, level zero, 1 sample")
        axes.grid(alpha=0.3)
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(LogLocator(10, subs=(1, 2, 5)))
            axis.set_major_formatter(StrMethodFormatter("{x:g}"))
            axis.set_minor_formatter(NullFormatter())
    panels[0].set_ylabel("RMSE to 1024 samples")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize=8, loc="outside lower center", ncols=3)
    return figure
