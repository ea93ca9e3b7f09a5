"""Measure the time and the memory that reading large drawings takes.

python -m experiments.svg_files.reading
"""

import resource
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path

import softras2d as sr
from tests.cases.hostile import low_poly, many_paths, polygon, spiral

from ..common import report

HERE = Path(__file__).parent

DRAWINGS = {
    "5,078 paths of one triangle": lambda: low_poly(5078),
    "1,000 paths of 100 points": lambda: many_paths(1000),
    "one polygon of 100,000 points": lambda: polygon(spiral(50_000)),
}

REPEATS = 5


def measure(path: str) -> None:
    """Print the number of triangles, the shortest times in seconds and the peak memory in GB."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        triangles = len(sr.read_svg(path).triangles)
    walls, processors = [], []
    for _ in range(REPEATS):
        wall, processor = time.perf_counter(), time.process_time()
        sr.read_svg(path)
        walls.append(time.perf_counter() - wall)
        processors.append(time.process_time() - processor)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
    print(triangles, min(walls), min(processors), peak)


def main() -> None:
    rows = []
    for name, body in DRAWINGS.items():
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "drawing.svg"
            head = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 10 10" '
            path.write_text(f'{head}width="800" height="800">{body()}</svg>')
            size = path.stat().st_size / 1e6
            # A separate process for each drawing, so that its peak memory can be measured.
            command = [sys.executable, "-m", f"{__package__}.reading", str(path)]
            output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        triangles, wall, processor, peak = map(float, output.split())
        row = [name, f"{size:.2f}", f"{triangles:,.0f}"]
        rows.append([*row, f"{wall:.2f}", f"{processor:.2f}", f"{peak:.2f}"])
        print(rows[-1], flush=True)
    header = ["drawing", "MB", "triangles", "s", "CPU time, s", "peak memory, GB"]
    report.fill_markers(HERE / "README.md", "reading", report.table(header, rows))


if __name__ == "__main__":
    measure(sys.argv[1]) if len(sys.argv) > 1 else main()
