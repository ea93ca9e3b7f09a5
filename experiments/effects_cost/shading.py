"""Compare the time of texturing every sample with the time of samples in flat colours.

python -m experiments.effects_cost.shading
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

import softras2d as sr

from ..common import report
from ..common.scenes import Soup
from ..common.timing import interleave

HERE = Path(__file__).parent
HEIGHT, WIDTH, SAMPLES = 600, 800, 16
TEXTURE, REPEATS = 256, 4
CELLS = (1, 12)
"""Squares along a side of the canvas: two triangles, or 288."""


def canvas_of_squares(cells: int) -> sr.Scene:
    """A canvas of `cells` x `cells` squares of two triangles; its noise texture repeats 4 times."""
    rng = np.random.default_rng(0)
    across, down = np.meshgrid(np.linspace(0, 1, cells + 1), np.linspace(0, 1, cells + 1))
    unit = np.stack([across, down], -1).astype(np.float32)
    a, b, c, d = unit[:-1, :-1], unit[:-1, 1:], unit[1:, :-1], unit[1:, 1:]
    corners = np.stack([a, b, c, b, d, c], 2).reshape(-1, 3, 2)
    image = rng.random((TEXTURE, TEXTURE, 3), np.float32)
    return sr.Scene.from_soup(
        corners * np.array([WIDTH, HEIGHT], np.float32),
        rng.random((len(corners), 3), np.float32),
        uv=corners * REPEATS,
        texture_index=np.zeros(len(corners), np.int32),
        textures=sr.TexturePyramid.build([image], border="repeat"),
    )


def contestants(cells: int) -> dict[str, Any]:
    """Programs to time, by their names in the table."""
    textured = canvas_of_squares(cells)
    flat = replace(textured, uv=None, texture_index=None, textures=None)
    # These corner colours are evaluated at each sample, without a texture.
    rng = np.random.default_rng(1)
    count = flat.triangles.shape[0]
    bent = replace(
        flat,
        colors=jnp.asarray(rng.random((count, 3, 3), np.float32)),
        inverse_w=jnp.asarray(rng.uniform(0.5, 1, flat.positions.shape[0]).astype(np.float32)),
    )
    zero = sr.Filter(level="zero")
    return {
        "flat, counted": _render(flat),
        "colours in perspective, each sample": _render(bent),
        "nearest, level zero": _render(textured, sr.Filter(pixel="nearest", level="zero")),
        "bilinear, level zero": _render(textured, zero),
        "trilinear": _render(textured, sr.Filter()),
        "trilinear, 4 probes": _render(textured, sr.Filter(anisotropy=4)),
        "trilinear, multisampled": _render(textured, sr.Filter(), "pixel"),
        **_loops(flat),
    }


def _render(scene: sr.Scene, filter: sr.Filter | None = None, shading: str = "sample"):
    coverage = sr.Hard(samples=SAMPLES, shading="pixel" if shading == "pixel" else "sample")
    plan = sr.plan(scene, height=HEIGHT, width=WIDTH, coverage=coverage, filter=filter)
    return lambda: sr.render(scene, plan).block_until_ready()


def _loops(flat: sr.Scene) -> dict[str, Any]:
    """Calls of the compiled loop over samples, in flat colours, by name.

    The loop's canvas is square, with as many pixels as the canvas of the package.
    """
    from ..hard_speed import scalar_loop

    side = round((HEIGHT * WIDTH) ** 0.5)
    scale = np.array([side / WIDTH, side / HEIGHT], np.float32)
    corners = np.asarray(flat.positions).reshape(-1, 3, 2) * scale
    colors = np.concatenate([np.asarray(flat.colors), np.ones_like(flat.colors[..., :1])], -1)
    soup = Soup("flat", side, 0, corners, colors.repeat(3, 1), np.ones(3, np.float32))
    rate = round(SAMPLES**0.5)
    return {
        "compiled loop, flat, each sample, 1 thread": lambda: scalar_loop.render(soup, rate, 1),
        "compiled loop, flat, each sample, 2 threads": lambda: scalar_loop.render(soup, rate, 2),
    }


YARDSTICK = "compiled loop, flat, each sample, 1 thread"
PERSPECTIVE = "colours in perspective, each sample"


def main() -> None:
    rows = []
    for cells in CELLS:
        times = interleave(contestants(cells), rounds=9, budget_s=30)
        for name, measured in times.items():
            rows.append(
                {
                    "triangles": 2 * cells * cells,
                    "drawn": name,
                    "median_ms": measured.median,
                    "least_ms": measured.least,
                    "cpu_ms": measured.cpu,
                    "over_loop": measured.median / times[YARDSTICK].median,
                    "over_own": measured.median / times[PERSPECTIVE].median,
                }
            )
    report.write_csv(HERE / "results" / "shading.csv", rows)
    header = ["program", "triangles", "ms", "processor ms", "time / loop", "time / untextured"]
    lines = [
        [
            row["drawn"],
            str(row["triangles"]),
            f"{row['median_ms']:.1f}",
            f"{row['cpu_ms']:.0f}",
            f"{row['over_loop']:.2f}",
            f"{row['over_own']:.2f}",
        ]
        for row in rows
    ]
    report.fill_markers(HERE / "README.md", "shading", report.table(header, lines))


if __name__ == "__main__":
    main()
