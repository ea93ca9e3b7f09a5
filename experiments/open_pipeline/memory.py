"""Measure the memory of one image and gradient by `resolve` in a fresh process; Linux only.

python -m experiments.open_pipeline.memory
"""

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

SIZE_PX, SAMPLES, TRIANGLES = 512, 256, 1000
_ROOT = Path(__file__).parents[2]


def measure() -> dict[str, Any]:
    """Measure the memory, in MiB, of one image and its gradient in a fresh process.

    - `program_mib`: arguments, results and temporaries, as the compiler lays them out.
    - `grown_mib`: how far the resident set grew during the call; `process_mib`: its peak.
    """
    done = subprocess.run(
        [sys.executable, "-m", __spec__.name], cwd=_ROOT, capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def draw_once() -> dict[str, float]:
    """Draw triangles whose colours a small network computes, with the gradient; return the MiB."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    import softras2d as sr

    from ..common.scenes import random_soup

    soup = random_soup(TRIANGLES, SIZE_PX, "gouraud")
    scene = sr.Scene.from_soup(soup.corners, soup.colors[..., :3])
    plan = sr.plan(scene, height=SIZE_PX, width=SIZE_PX, coverage=sr.Hard(SAMPLES))
    rng = np.random.default_rng(0)
    layers = [jnp.asarray(rng.normal(size=shape), jnp.float32) for shape in ((3, 6), (6, 3))]

    def loss(positions: Any, layers: Any) -> Any:
        visible = sr.rasterize(replace(scene, positions=positions), plan)

        def shade(triangle: Any, weights: Any) -> Any:
            colors = jnp.einsum("nk,nkc->nc", weights, scene.colors[triangle])
            return jnp.tanh(jnp.tanh(colors @ layers[0]) @ layers[1])

        return jnp.mean(sr.resolve(visible, shade) ** 2)

    arguments = (scene.positions, layers)
    program = jax.jit(jax.value_and_grad(loss, (0, 1))).lower(*arguments).compile()
    program_memory: Any = program.memory_analysis()
    bytes_of_program = (
        program_memory.argument_size_in_bytes
        + program_memory.output_size_in_bytes
        + program_memory.temp_size_in_bytes
    )
    before, peak_before = _status_mib("VmRSS"), _status_mib("VmHWM")
    # Resets VmHWM to the current resident set.
    Path("/proc/self/clear_refs").write_text("5")
    results = jax.block_until_ready(program(*arguments))
    peak = _status_mib("VmHWM")
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(results))
    return {
        "program_mib": bytes_of_program / 2**20,
        "grown_mib": peak - before,
        "process_mib": max(peak, peak_before),
    }


def _status_mib(name: str) -> float:
    """A memory entry of this process's status, in MiB."""
    status = Path("/proc/self/status").read_text()
    return int(re.search(rf"{name}:\s+(\d+) kB", status)[1]) / 1024  # pyright: ignore


if __name__ == "__main__":
    print(json.dumps(draw_once()))
