"""Move the control points of one drawing until its image looks like that of another drawing.

python -m experiments.svg_files.move
"""

from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax

import softras2d as sr

from ..common import report

HERE = Path(__file__).parent
START, TARGET = HERE / "moved" / "pear.svg", HERE / "moved" / "apple.svg"
END = HERE / "results" / "pear_as_apple.svg"

SIDE = 120
STAGES = (
    *((sr.Soft(width=2.0), 30),) * 6, *((sr.Area(), 40),) * 4,
)  # fmt: skip
"""Coverage and number of steps of each stage. Each stage ends with a new triangulation."""

LEARNING_RATE = 0.25
"""Learning rate of Adam, in units of the drawing."""


def image_of(scene: sr.Scene) -> jax.Array:
    """The image at 16 samples per pixel."""
    plan = sr.plan(scene, height=SIDE, width=SIDE, coverage=sr.Hard(samples=16))
    return sr.render(scene, plan)


def rmse(first: jax.Array, second: jax.Array) -> float:
    """Root of the mean squared difference of two images, in levels of 255."""
    return float(255 * jnp.sqrt(jnp.mean((first - second) ** 2)))


def main() -> None:
    controls = sr.read_svg_controls(START)
    target = image_of(sr.read_svg(TARGET))
    points = controls.points
    optimizer = optax.adam(LEARNING_RATE)
    state = optimizer.init(points)
    for coverage, steps in STAGES:
        plan = sr.plan(
            controls.moved(points),
            height=SIDE,
            width=SIDE,
            coverage=coverage,
            capacity="worst_case",
        )

        @eqx.filter_jit
        def step(points, state, plan=plan, controls=controls):
            def loss(points):
                return jnp.mean((sr.render(controls.moved(points), plan) - target) ** 2)

            gradient = jax.grad(loss)(points)
            updates, state = optimizer.update(gradient, state)
            return points + updates, state

        for _ in range(steps):
            points, state = step(points, state)
        # The map moves triangles, and a fold in them is no edge of the drawing.
        sr.write_svg(END, eqx.tree_at(lambda c: c.points, controls, points))
        controls = sr.read_svg_controls(END)
        print(f"{coverage}: {rmse(image_of(controls.moved(points)), target):.1f}", flush=True)
    start, end = image_of(sr.read_svg(START)), image_of(sr.read_svg(END))
    picture = np.concatenate([np.asarray(image) for image in (start, end, target)], axis=1)
    sr.write_image(HERE / "results" / "move.png", np.repeat(np.repeat(picture, 2, 0), 2, 1))
    constant = sum(controls.constant_vertices.values())
    rows = [
        ["control points", f"{len(controls.points)}"],
        ["vertices", f"{len(controls.controls)}"],
        ["constant vertices", f"{constant}"],
        ["RMSE of the start, of 255", f"{rmse(start, target):.1f}"],
        ["RMSE of the written file, of 255", f"{rmse(end, target):.1f}"],
    ]
    report.fill_markers(HERE / "README.md", "move", report.table(["", ""], rows))


if __name__ == "__main__":
    main()
