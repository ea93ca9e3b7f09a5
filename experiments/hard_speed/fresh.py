"""Measurements that need a process of their own: the first render, and peak memory.

    python -m experiments.hard_speed.fresh KIND COUNT SIZE SAMPLES

prints one line of JSON; `measure` runs that with JAX's persistent compilation cache off.
"""

import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from ..common.scenes import random_soup

_ROOT = Path(__file__).parents[2]


def measure(kind: str, count: int, size: int, samples: int) -> dict[str, Any]:
    """Seconds and mebibytes of a fresh process that draws one scene, then one alike.

    `first_s` is scene, plan and first render together, compilation included, after the imports;
    `alike_s` the same for a scene of other random triangles; `peak_mib` the most memory ever held.
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

    from .own import package_scene

    # Names load on first use: take them here, so that imports are not counted as drawing.
    plan_scene, render, hard = sr.plan, sr.render, sr.Hard(samples=samples)
    result: dict[str, Any] = {"import_s": lap(), "import_mib": _peak_mib()}
    for which, seed in (("first", 0), ("alike", 1)):
        soup = random_soup(count, size, kind, seed)
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
    """Largest resident set so far: kibibytes on Linux, bytes on macOS."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (2**20 if sys.platform == "darwin" else 2**10)


if __name__ == "__main__":
    kind, *numbers = sys.argv[1:]
    print(json.dumps(_draw_two(kind, *map(int, numbers))))
