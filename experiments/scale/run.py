"""Measure a huge canvas and a million triangles: `python -m experiments.scale.run [--quick]`."""

import argparse
import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

from .cases import COVERAGES, Case

HERE = Path(__file__).parent


def cases(quick: bool, canvas: int) -> list[Case]:
    """The measurements, cheapest first."""
    triangles, side = (20_000, 256) if quick else (1_000_000, 2048)
    of_triangles = [
        Case(kind, side, triangles, coverage)
        for kind in ("image", "gradient")
        for coverage in (["Hard"] if quick else COVERAGES)
    ]
    canvases = (
        [Case("canvas", 2048, 2_000)]
        if quick
        else [
            Case("canvas", canvas, 100_000),
            Case("strip", canvas, 100_000, samples=16, rows=1024),
        ]
    )
    return [*canvases, *of_triangles]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--quick", action="store_true", help="Run small sizes; results go to cache/."
    )
    parser.add_argument("--canvas", type=int, default=50_000, help="Side of the canvas, in pixels.")
    parser.add_argument("--only", choices=("canvas", "strip", "image", "gradient"))
    options = parser.parse_args()
    folder = HERE / ("cache" if options.quick or options.only else "results")
    folder.mkdir(exist_ok=True)
    rows = []
    for case in cases(options.quick, options.canvas):
        if options.only not in (None, case.kind):
            continue
        command = [sys.executable, "-m", "experiments.scale.cases", json.dumps(asdict(case))]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            # If a case runs out of memory, the other cases must still be measured.
            print(f"{case}: failed\n{done.stderr[-2000:]}", file=sys.stderr)
            continue
        rows.append(json.loads(done.stdout.splitlines()[-1]))
        print(rows[-1], flush=True)
        text = json.dumps({"python": sys.version.split()[0], "seed": 0, "rows": rows}, indent=1)
        (folder / "scale.json").write_text(text + "\n")


if __name__ == "__main__":
    main()
