"""The measured cases; each runs in a separate process, so that its peak memory can be read."""

import json
import resource
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import softras2d as sr

COVERAGES = {"Hard": sr.Hard(4), "Soft": sr.Soft(1.0), "Area": sr.Area()}


@dataclass(frozen=True)
class Case:
    """One measurement.

    - `kind`: "canvas" (a tiled image in a file), "strip" (some rows of a canvas), "image" or
      "gradient".
    - `side`: side of the canvas, in pixels; `triangles`: number of triangles.
    - `coverage`: a name of `COVERAGES`, for an image or a gradient.
    - `samples`: samples per pixel, for a canvas or strip.
    - `rows`: rows of pixels of a strip, from the middle of the canvas downwards.
    """

    kind: str
    side: int
    triangles: int
    coverage: str = "Hard"
    samples: int = 1
    rows: int | None = None


def random_scene(triangles: int, side: int, size: float) -> sr.Scene:
    """Flat triangles of about `size` pixels, at random positions on the canvas."""
    rng = np.random.default_rng(0)
    centers = rng.uniform(0, side, (triangles, 1, 2))
    corners = centers + rng.normal(size=(triangles, 3, 2)) * size
    return sr.Scene.from_soup(corners.astype(np.float32), rng.random((triangles, 3)))


def measure(case: Case) -> dict[str, Any]:
    """Processor seconds of each stage, and the peak resident memory in MiB."""
    is_canvas = case.kind in ("canvas", "strip")
    seconds = measure_canvas(case) if is_canvas else measure_triangles(case)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {**vars(case), **seconds, "peak_mib": round(peak)}


def measure_canvas(case: Case) -> dict[str, Any]:
    """Plan a canvas or strip, and draw it into a TIFF; return times in seconds, and sizes."""
    scene = random_scene(case.triangles, case.side, case.side / 400)
    began, began_wall = time.process_time(), time.perf_counter()
    drawn: dict[str, Any] = {"height": case.side}
    if case.rows is not None:
        # The strip is as wide as the canvas, so vertices snap to the same grid.
        drawn = {"height": case.rows, "origin": (0, case.side // 2)}
    plan = sr.plan_tiles(scene, width=case.side, coverage=sr.Hard(case.samples), **drawn)
    planned = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "canvas.tif"
        sr.write_tiles(path, scene, plan)
        size = path.stat().st_size
    return {
        "plan_s": round(planned - began, 2),
        "run_s": round(time.process_time() - planned, 1),
        "wall_s": round(time.perf_counter() - began_wall, 1),
        "windows": plan.cut.count,
        "programs": len(plan.plans),
        "file_mib": round(size / 2**20),
    }


def measure_triangles(case: Case) -> dict[str, Any]:
    """Plan, compile and run an image, or its gradient with respect to positions and colours.

    The time to plan and the time to run are each the lesser of two.
    """
    scene = random_scene(case.triangles, case.side, 2.0)
    arguments: dict[str, Any] = {"height": case.side, "width": case.side}
    plan_times = []
    for _ in range(2):
        start = time.process_time()
        plan = sr.plan(scene, coverage=COVERAGES[case.coverage], **arguments)
        plan_times.append(time.process_time() - start)
    planned = time.process_time()
    floats, rest = eqx.partition(sr.pad(scene), eqx.is_inexact_array)

    def draw(floats: sr.Scene, rest: sr.Scene) -> Any:
        return sr.render_checked(eqx.combine(floats, rest), plan)

    def loss(floats: sr.Scene, rest: sr.Scene) -> Any:
        image, overflow = draw(floats, rest)
        return jnp.mean(image**2), overflow

    # Indices are arguments, because the compiler would fold constants of a million entries.
    function = draw if case.kind == "image" else jax.value_and_grad(loss, has_aux=True)
    program = jax.jit(function).lower(floats, rest).compile()
    compiled = time.process_time()
    times = []
    for _ in range(2):
        start = time.process_time()
        result = jax.block_until_ready(program(floats, rest))
        times.append(time.process_time() - start)
    overflow = result[1] if case.kind == "image" else result[0][1]
    assert not bool(overflow)
    return {
        "plan_s": round(min(plan_times), 2),
        "compile_s": round(compiled - planned, 1),
        "run_s": round(min(times), 2),
        "windows": 1,
        "programs": 1,
    }


if __name__ == "__main__":
    print(json.dumps(measure(Case(**json.loads(sys.argv[1])))))
