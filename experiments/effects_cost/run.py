"""Time each effect of each bundled scene: `python -m experiments.effects_cost.run`."""

import argparse
from pathlib import Path
from typing import Any

import softras2d as sr
from softras2d import scenes
from softras2d.rendering.cost import Price, price_effects

from ..common import machine, report
from ..common.progress import steps

HERE = Path(__file__).parent
SIZE, SAMPLES = 300, 16
FILTER = sr.Filter(anisotropy=4)
PACKAGES = ("jax", "jaxlib", "equinox", "numpy", "softras2d")


def price(name: str) -> list[dict[str, Any]]:
    """One row for the scene with all effects, and one row for the scene without each effect."""
    scene = scenes.read(name, height=SIZE, width=SIZE)
    coverage = sr.Hard(samples=SAMPLES)
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=coverage, filter=FILTER)
    return [
        {
            "scene": name,
            "effect": "the whole scene" if effect is None else effect,
            **_columns("", whole),
            **_columns("_without", less),
            "share": 1 - less.seconds / whole.seconds if effect else "",
        }
        for effect, whole, less in price_effects(scene, plan, repeats=5)
    ]


def _columns(suffix: str, price: Price) -> dict[str, float]:
    return {
        f"ms{suffix}": 1e3 * price.seconds,
        f"mib{suffix}": price.memory / 2**20,
        f"mega_operations{suffix}": price.operations / 1e6,
        f"mib_moved{suffix}": price.traffic / 2**20,
    }


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown table: the time of every scene, and its time without each effect."""
    lines = []
    for row in rows:
        is_whole_scene = row["effect"] == "the whole scene"
        with_it, without = (f"{row[key]:.1f}" for key in ("ms", "ms_without"))
        lines.append(
            [
                f"**{row['scene']}**" if is_whole_scene else f"without {row['effect']}",
                with_it if is_whole_scene else without,
                "" if is_whole_scene else f"{100 * row['share']:+.0f} %",
                f"{row['mib' if is_whole_scene else 'mib_without']:.1f}",
                f"{row['mega_operations' if is_whole_scene else 'mega_operations_without']:.0f}",
                f"{row['mib_moved' if is_whole_scene else 'mib_moved_without']:.0f}",
            ]
        )
    header = ["scene", "ms", "effect's share", "MiB", "10^6 operations", "MiB moved"]
    return report.table(header, lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description="Measure what the effects of the bundled scenes cost."
    )
    parser.add_argument("--only", default="", help="Names of scenes, separated by commas.")
    only = {name for name in parser.parse_args().only.split(",") if name}
    names = [name for name in scenes.names() if not only or name in only]
    rows: list[dict[str, Any]] = []
    for name in steps(names, "pricing"):
        rows += price(name)
        if not only:
            # Write after each scene, so that results remain if the run is interrupted.
            report.write_csv(HERE / "results" / "prices.csv", rows)
            report.fill_markers(HERE / "README.md", "prices", table(rows))
    if only:
        print(table(rows))
        return
    setting = {"size_px": SIZE, "samples": SAMPLES, "anisotropy": FILTER.anisotropy}
    record = {"machine": machine.record(PACKAGES), "precision": "float32", **setting}
    report.write_json(HERE / "results" / "run.json", record)


if __name__ == "__main__":
    main()
