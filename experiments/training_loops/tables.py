"""Markdown tables of the results, for the README."""

import json
from pathlib import Path
from typing import Any

from ..common import machine, report
from . import batches


def publish(results: Path, readme: Path | None) -> None:
    """Write the tables with results into the README, or print them if `readme` is None."""
    run = json.loads((results / "run.json").read_text())
    texts = {}
    if "lasting" in run:
        texts |= {"lasting": lasting(run["lasting"]), "replanning": replanning(run["lasting"])}
    for name, table in (("ways", ways), ("batches", growth)):
        path = results / f"{name}.csv"
        if path.exists():
            texts[name] = table(report.read_csv(path))
    texts["machine"] = machine.describe(run, seed=f"seed {run['seed']}") + "."
    report.fill_or_print(readme, texts)


def lasting(rows: dict[str, Any]) -> str:
    """Each loop with one program: what went wrong in its steps, and its speed."""
    header = [
        "loop", "programs compiled in step 1", "programs compiled later",
        "steps that outgrew the plan", "first such step", "steps not finite", "steps per second",
        "ratio to dense", "loss, first to last",
    ]  # fmt: skip
    dense = rows["dense"]["steps_per_cpu_second"]
    body = [
        [
            name,
            str(row["compiled_in_first_step"]),
            str(row["compiled_later"]),
            f"{row['overflows']:,}",
            "-" if row["first_overflow"] is None else str(row["first_overflow"]),
            f"{row['not_finite']:,}",
            f"{row['steps_per_cpu_second']:.0f}",
            f"{row['steps_per_cpu_second'] / dense:.1f}",
            f"{row['first_loss']:.3f} to {row['last_loss']:.4f}",
        ]
        for name, row in rows.items()
        if "overflows" in row
    ]
    return report.table(header, body)


def replanning(rows: dict[str, Any]) -> str:
    """Each loop with `value_and_grad_replanning`."""
    header = ["loop", "new plans", "steps not finite", "seconds", "loss, first to last"]
    body = [
        [
            name,
            str(row["replans"]),
            str(row["not_finite"]),
            f"{row['cpu_seconds']:.0f}",
            f"{row['first_loss']:.3f} to {row['last_loss']:.4f}",
        ]
        for name, row in rows.items()
        if "replans" in row
    ]
    return report.table(header, body)


def ways(rows: list[dict[str, Any]]) -> str:
    """Least time of a batch by each way, in milliseconds, and the ratios that have goals."""
    time = {(row["scene"], row["coverage"], row["way"]): float(row["least_ms"]) for row in rows}
    header = [
        "batch of 16", "coverage", "vmap, ms", "lax.map, ms", "loop, ms", "vmap / loop",
        "dense: vmap, ms", "dense: lax.map, ms", "vmap / faster dense",
    ]  # fmt: skip
    body = []
    for scene, coverage in dict.fromkeys((row["scene"], row["coverage"]) for row in rows):
        if coverage == "dense":
            continue
        vmap, mapped, loop = (
            time[scene, coverage, way] for way in (batches.VMAP, batches.MAP, batches.LOOP)
        )
        dense = [time[scene, "dense", way] for way in (batches.DENSE, batches.DENSE_MAP)]
        body.append(
            [
                scene,
                coverage,
                *(f"{one:.1f}" for one in (vmap, mapped, loop)),
                f"{vmap / loop:.2f}",
                *(f"{one:.1f}" for one in dense),
                f"{vmap / min(dense):.2f}",
            ]
        )
    return report.table(header, body)


def growth(rows: list[dict[str, Any]]) -> str:
    """Least time per scene, in milliseconds, in batches of each size."""
    time = {
        (row["scene"], row["coverage"], int(row["batch"])): float(row["least_ms"]) for row in rows
    }
    header = ["ms per scene", "method", *(f"batch of {count}" for count in batches.BATCHES)]
    body = [
        [
            scene,
            coverage,
            *(f"{time[scene, coverage, count] / count:.2f}" for count in batches.BATCHES),
        ]
        for scene, coverage in dict.fromkeys((row["scene"], row["coverage"]) for row in rows)
    ]
    return report.table(header, body)
