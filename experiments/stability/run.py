"""Measure how far float32 is from float64 in numerically difficult cases.

python -m experiments.stability.run [--modes hard,glass,soft,area,sum]
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
from rich.console import Console
from rich.table import Table

from tests.cases import stability_attributes, stability_degenerate
from tests.cases.stability_cases import CASES, MODES
from tests.cases.stability_measure import LONG_MODES, long_sum, measure, moved

from ..common import machine, progress, report
from . import figure

HERE = Path(__file__).parent
PACKAGES = ("softras2d", "jax", "jaxlib", "numpy")
SHIFTS = tuple(10**power for power in range(7))


def case_rows(modes: list[str]) -> list[dict[str, Any]]:
    """Errors, with one row for each case and mode."""
    return _measured(CASES, modes, measure, "cases")


def attribute_rows() -> list[dict[str, Any]]:
    """Errors of each case with corner colours, textures, perspective and depth."""
    return _measured(
        stability_attributes.CASES,
        list(stability_attributes.MODES),
        stability_attributes.measure,
        "attributes",
    )


def degenerate_rows(modes: list[str]) -> list[dict[str, Any]]:
    """Difference of jvp and vjp, and the largest gradient, for triangles with little or no area."""
    rows = []
    for mode in progress.steps(modes, "degenerate triangles"):
        for row in stability_degenerate.measure(mode):
            rows.append({**row, "within": "yes" if stability_degenerate.within(row) else "NO"})
    return rows


def _measured(
    cases: dict[str, Any], modes: list[str], measure: Callable[[Any, str], Any], title: str
) -> list[dict[str, Any]]:
    pairs = [(mode, name) for mode in modes for name in cases if mode in cases[name]().modes]
    rows = []
    for mode, name in progress.steps(pairs, title):
        case = cases[name]()
        errors = measure(case, mode)
        stated = dict(zip(("stated_value", "stated_product"), case.limits, strict=True))
        verdict = "yes" if errors.within(case.limits) else "NO"
        rows.append({"case": name, "mode": mode, **errors._asdict(), **stated, "within": verdict})
    return rows


def shift_rows(modes: list[str]) -> list[dict[str, Any]]:
    """Errors of an ordinary scene that is moved together with its origin."""
    rows = []
    for mode, shift in progress.steps([(m, s) for m in modes for s in SHIFTS], "shifts"):
        errors, _ = moved(mode, shift, on_grid=False)
        _, same = moved(mode, shift, on_grid=True)
        numbers = {"value": errors.value, "gradient": errors.gradient}
        rows.append({"mode": mode, "shift_px": shift, "same_bits_on_grid": same, **numbers})
    return rows


def sum_rows(modes: list[str]) -> list[dict[str, Any]]:
    """Bias of the gradient of a sum over a large image, under each mode."""
    rows = []
    for mode in progress.steps([mode for mode in modes if mode in LONG_MODES], "long sums"):
        by_color, by_corners = long_sum(mode)
        rows.append({"mode": mode, "by_color": by_color, "by_positions": by_corners})
    return rows


def show(rows: list[dict[str, Any]]) -> None:
    """Print the table of cases on the terminal."""
    header, lines = figure.case_table(rows)
    table = Table(*header, title="value; worst of gradient, jvp and Gauss-Newton product")
    for line in lines:
        table.add_row(*line)
    Console().print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--modes", default=",".join(MODES))
    modes = parser.parse_args().modes.split(",")
    # The tests use this setting, too.
    jax.config.update("jax_numpy_dtype_promotion", "strict")
    began, results = time.perf_counter(), HERE / "results"
    rows = case_rows(modes)
    show(rows)
    if modes != list(MODES):
        return
    report.write_csv(results / "cases.csv", rows)
    report.write_csv(results / "attributes.csv", attribute_rows())
    report.write_csv(results / "degenerate.csv", degenerate_rows(list(stability_degenerate.MODES)))
    report.write_csv(results / "shifts.csv", shift_rows(modes))
    report.write_csv(results / "long_sums.csv", sum_rows(modes))
    seconds = round(time.perf_counter() - began)
    about = {"precision": "float32, the truth float64", "seed": 0, "seconds": seconds}
    report.write_json(results / "run.json", {"machine": machine.record(PACKAGES), **about})
    figure.publish(results, HERE / "README.md")


if __name__ == "__main__":
    main()
