"""Random extreme scenes have the oracle's coverage, and finite numbers in every mode."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..cases.far_triangles import covered_by, near_an_edge, project_one
from ..cases.fuzzing import cases
from ..oracles.coverage import Canvas, footprint, snap

SIDE = 16
COUNT = 6

MODES = {
    "hard": sr.Hard(4),
    "soft": sr.Soft(0.7),
    "softras": sr.Soft(1e-3, "softras"),
    "area": sr.Area(),
    "sum": sr.Area("sum"),
}


def extreme_corners(rng: np.random.Generator, count: int, farthest: float) -> np.ndarray:
    """Corners `[count, 3, 2]` of near and far triangles, many of them slivers or without area."""
    size = SIDE * 10.0 ** rng.uniform(-4, farthest, (count, 1, 1))
    corners = rng.uniform(0, SIDE, (count, 1, 2)) + rng.normal(size=(count, 3, 2)) * size
    for index, kind in enumerate(rng.integers(0, 8, count)):
        first, second, third = corners[index]
        if kind == 0:
            corners[index, 2] = first + (second - first) * rng.uniform(-1, 2)
        elif kind == 1:
            corners[index, 1] = first
        elif kind == 2:
            corners[index, :, rng.integers(2)] = np.round(corners[index, 0, 0])
        elif kind == 3:
            corners[index] = np.round(corners[index] * 2) / 2
        elif kind == 4:
            corners[index, 2] = third * 10.0 ** rng.uniform(0, 30)
    return corners.astype(np.float32)


@pytest.mark.slow
def test_coverage_equals_the_oracle_up_to_a_thousand_canvases_away():
    """Only samples within two grid units of an edge may differ, and only for far triangles."""
    for _, rng in cases(0.5):
        height, width = (int(n) for n in rng.integers(1, 33, 2))
        origin = tuple(int(n) for n in rng.integers(-5000, 5000, 2))
        on = Canvas(
            height, width, int(rng.choice([1, 2, 3, 4])), rng.choice(["inclusive", "top_left"])
        )
        on = replace(on, origin=origin)
        side = max(height, width)
        far = side * 10.0 ** rng.uniform(-1, 3)
        corners = rng.normal(size=(3, 2)) * far + rng.uniform(0, side, 2) + origin
        if rng.random() < 0.3:
            corners[rng.integers(3)] = rng.integers(0, 2 * side, 2) / 2 + origin
        corners = corners.astype(np.float32)
        projection = project_one(corners, on)
        snapped = snap(corners[None], on, anywhere=True)[0]
        covered = footprint(snapped, on)
        expected = np.zeros((height * on.rate, width * on.rate), bool)
        expected[covered.rows, covered.columns] = covered.inside
        wrong = covered_by(projection, on) != expected
        cut = bool(projection.is_far[0])
        assert not (wrong & ~(near_an_edge(snapped, on) & cut)).any(), (corners, on)


@pytest.mark.slow
@pytest.mark.parametrize("mode", MODES)
def test_numbers_stay_finite_and_bounded(mode):
    """The image, gradient and jvp are finite, and the gradient is bounded by the canvas size.

    A vertex moves its edges, and only pixels along the part of these edges on the canvas change.
    """
    rng = np.random.default_rng(12)
    colors = rng.random((COUNT, 3, 3))
    made = [sr.Scene.from_soup(extreme_corners(rng, COUNT, 3.0), colors) for _ in range(12)]
    around = np.array([(-1, -1), (3, -1), (-1, 3)]) * SIDE
    made.append(sr.Scene.from_soup(np.tile(around, (COUNT, 1, 1)).astype(np.float32), colors))
    plan = sr.plan(made, height=SIDE, width=SIDE, coverage=MODES[mode])
    weight = jnp.asarray(rng.normal(size=(SIDE, SIDE, 3)), jnp.float32)

    @jax.jit
    def differentiate(positions: Any, direction: Any) -> Any:
        def image(positions):
            return sr.render_checked(replace(made[0], positions=positions), plan)

        drawn, tangent, overflow = jax.jvp(image, (positions,), (direction,), has_aux=True)
        gradient = jax.grad(lambda x: jnp.sum(weight * image(x)[0]))(positions)
        return drawn, tangent, gradient, overflow

    drawn_scenes = all_scenes = 0
    for _, rng in cases(0.1):
        corners = extreme_corners(rng, COUNT, 3.0)
        direction = rng.normal(size=(3 * COUNT, 2)).astype(np.float32)
        drawn, tangent, gradient, overflow = differentiate(corners.reshape(-1, 2), direction)
        all_scenes += 1
        if overflow:
            continue
        drawn_scenes += 1
        for value in (drawn, tangent, gradient):
            assert np.isfinite(value).all(), corners.tolist()
        assert np.abs(drawn).max() <= COUNT + 1
        # The coverage of a soft edge one thousandth of a pixel wide rises by 1 within this width.
        steepest = 1e3 if mode == "softras" else 10.0
        assert np.abs(gradient).max() <= 10 * SIDE * steepest, corners.tolist()
    assert drawn_scenes > all_scenes / 2
