"""Compare the compiler's figure for memory with the growth of a fresh process.

    python -m experiments.scaling.memory WHAT KIND TRIANGLES SIZE_PX SAMPLES OVERDRAW BATCH

prints one line of JSON; `measure` runs this command. Linux only: the program reads and resets
VmHWM, the largest resident set so far.
"""

import json
import os
import re
import subprocess
import sys
from dataclasses import asdict, astuple
from pathlib import Path
from typing import Any

from .cases import Case

_ROOT = Path(__file__).parents[2]


def measure(what: str, case: Case) -> dict[str, Any]:
    """Memory, in MiB, of a process that draws one case once.

    - `program_mib`: arguments, results and temporaries, as the compiler lays them out.
    - `arguments_mib`: the arguments, which the process has before the call.
    - `grown_mib`: how far the resident set grew above its size before the call.
    - `imported_mib`: the resident set after the imports.
    - `process_mib`: the peak of the process, planning and compiling included.
    """
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")}
    environment["JAX_ENABLE_COMPILATION_CACHE"] = "false"
    command = [sys.executable, "-m", __spec__.name, what, *map(str, astuple(case))]
    done = subprocess.run(
        command, cwd=_ROOT, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command[1:])} failed:\n{done.stderr}")
    return {"what": what, **asdict(case), **json.loads(done.stdout.splitlines()[-1])}


def _draw_once(what: str, case: Case) -> dict[str, float]:
    from .growth import Drawing

    result = {"imported_mib": _status_mib("VmHWM")}
    program = Drawing(case).program(what)
    before, before_peak = _status_mib("VmRSS"), _status_mib("VmHWM")
    Path("/proc/self/clear_refs").write_text("5")  # Reset VmHWM to the current resident set.
    # The results must be alive when the peak is read.
    results = program()
    peak = _status_mib("VmHWM")
    del results
    return result | {
        "program_mib": program.memory / 2**20,
        "arguments_mib": program.argument_memory / 2**20,
        "grown_mib": peak - before,
        "process_mib": max(before_peak, peak),
    }


def _status_mib(name: str) -> float:
    status = Path("/proc/self/status").read_text()
    return int(re.search(rf"{name}:\s+(\d+) kB", status)[1]) / 1024  # pyright: ignore


def _case(words: list[str]) -> Case:
    kind, triangles, size_px, samples, overdraw, batch = words
    return Case(kind, int(triangles), int(size_px), int(samples), float(overdraw), int(batch))


if __name__ == "__main__":
    print(json.dumps(_draw_once(sys.argv[1], _case(sys.argv[2:]))))
