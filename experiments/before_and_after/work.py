"""Render and differentiate scenes in a separate process, with softras2d of a given checkout.

The process reads one command per line from standard input, and answers each with a line of JSON.
This file imports nothing else of the project, because an old checkout has other experiments:

    python work.py SCENES.npz
    prepare KIND COUNT SIZE COVERAGE CALL
    call
"""

import json
import resource
import sys
import time
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import softras2d as sr
from softras2d import scenes

COVERAGES: dict[str, Callable[[], Any]] = {
    "hard": lambda: sr.Hard(16),
    "soft": lambda: sr.Soft(0.8),
    "area": lambda: sr.Area(),
}


def main() -> None:
    """Answer commands until standard input ends."""
    arrays = np.load(sys.argv[1])
    call: Callable[[], object] | None = None
    for line in sys.stdin:
        command, *words = line.split()
        if command == "prepare":
            kind, count, size, coverage, what = words
            scene = _scene(arrays, kind, int(count), int(size))
            call = _call(scene, int(size), COVERAGES[coverage](), what)
            began, before = time.perf_counter(), _resident_mib()
            call()
            seconds = time.perf_counter() - began
            # The second call allocates the memory that later calls reuse.
            call()
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
            answer = {"first_s": seconds, "peak_mib": peak, "before_mib": before}
        else:
            assert call is not None, "prepare first"
            processor, wall = time.process_time(), time.perf_counter()
            call()
            wall_ms = 1e3 * (time.perf_counter() - wall)
            answer = {"wall_ms": wall_ms, "processor_ms": 1e3 * (time.process_time() - processor)}
        print(json.dumps(answer), flush=True)


def _scene(arrays: Any, kind: str, count: int, size: int) -> Any:
    if kind == "minified":
        return scenes.read(kind, height=size, width=size)
    name = f"{kind}_{count}_{size}"
    colors = arrays[f"{name}_colors"]
    return sr.Scene.from_soup(arrays[f"{name}_corners"], colors)


def _call(scene: Any, size: int, coverage: Any, what: str) -> Callable[[], object]:
    """Compile the image, or the loss and its gradient with respect to positions and colours."""
    plan = sr.plan(scene, height=size, width=size, coverage=coverage)
    target = np.random.default_rng(1).random((size, size, 3), dtype=np.float32)

    def image(positions: jax.Array, colors: jax.Array) -> jax.Array:
        moved = eqx.tree_at(lambda s: (s.positions, s.colors), scene, (positions, colors))
        return sr.render(moved, plan)

    def loss(positions: jax.Array, colors: jax.Array) -> jax.Array:
        return jnp.sum((image(positions, colors) - target) ** 2)

    compiled = jax.jit(image if what == "image" else jax.value_and_grad(loss, argnums=(0, 1)))
    return lambda: jax.block_until_ready(compiled(scene.positions, scene.colors))


def _resident_mib() -> float:
    """Resident memory of this process, in MiB (Linux)."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 2**20


if __name__ == "__main__":
    main()
