"""Measure the first render and peak memory of a separate process.

    python -m experiments.hard_speed.fresh KIND COUNT SIZE SAMPLES

prints one line of JSON; `measure` runs this command with JAX's persistent compilation cache off.
"""

import dataclasses
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from ..common.scenes import random_soup

_ROOT = Path(__file__).parents[2]


def measure(kind: str, count: int, size: int, samples: int) -> dict[str, Any]:
    """Seconds and mebibytes of a fresh process that draws one scene, then a similar scene.

    - `first_s`: scene, plan and first render, compilation included, but not the imports.
    - `first_render_s`: the first render alone.
    - `alike_s`: as `first_s`, for the scene with triangles moved by half a pixel and other colours.
    - `peak_mib`: peak of resident memory.
    """
    environment = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")}
    environment["JAX_ENABLE_COMPILATION_CACHE"] = "false"
    command = [sys.executable, "-m", __spec__.name, kind, str(count), str(size), str(samples)]
    done = subprocess.run(
        command, cwd=_ROOT, env=environment, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command[1:])} failed:\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def _draw_two(kind: str, count: int, size: int, samples: int) -> dict[str, Any]:
    clock = [time.perf_counter()]

    def lap() -> float:
        clock.append(time.perf_counter())
        return clock[-1] - clock[-2]

    import softras2d as sr

    from .ours import package_scene

    # The package imports names on first use; import them here, so that no import is timed.
    plan_scene, render, hard = sr.plan, sr.render, sr.Hard(samples=samples)
    result: dict[str, Any] = {"import_s": lap(), "import_mib": _peak_mib()}
    first = random_soup(count, size, kind)
    alike = dataclasses.replace(
        first, corners=first.corners + np.float32(0.5), colors=first.colors[::-1]
    )
    for which, soup in (("first", first), ("alike", alike)):
        lap()
        scene = package_scene(soup)
        result[f"{which}_scene_s"] = lap()
        plan = plan_scene(scene, height=size, width=size, coverage=hard)
        result[f"{which}_plan_s"] = lap()
        render(scene, plan).block_until_ready()
        result[f"{which}_render_s"] = lap()
        result[f"{which}_s"] = sum(
            result[f"{which}_{part}_s"] for part in ("scene", "plan", "render")
        )
    return result | {"peak_mib": _peak_mib()}


def _peak_mib() -> float:
    """Largest resident set of this program so far (Linux).

    `getrusage` is no alternative: its value survives `exec`, so it may be the parent's peak.
    """
    status = Path("/proc/self/status").read_text()
    return int(re.search(r"VmHWM:\s+(\d+) kB", status)[1]) / 1024  # pyright: ignore


if __name__ == "__main__":
    kind, *numbers = sys.argv[1:]
    print(json.dumps(_draw_two(kind, *map(int, numbers))))
