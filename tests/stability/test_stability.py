"""Hard scenes, case by case: finite, and within a stated error of float64.

`python -m experiments.stability.run` measures the same and prints the table.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..cases.products import moving, products, stack
from ..cases.stability_cases import CASES, MODES
from ..cases.stability_measure import LONG_MODES, long_sum, measure, moved

QUICK = ("soft", "area")
"""Modes that are no long tests."""

LONG = ("one pixel", "1000 layers")
"""Cases that have programs of their own."""


def row(mode: str, case: str) -> Any:
    marks = [] if mode in QUICK and case not in LONG else [pytest.mark.slow]
    return pytest.param(mode, case, marks=marks, id=f"{mode}-{case}")


@pytest.mark.parametrize(
    "mode, name",
    [row(mode, name) for mode in MODES for name in CASES if mode in CASES[name]().modes],
)
def test_within_stated_errors(mode, name):
    case = CASES[name]()
    found = measure(case, mode)
    assert found.within(case.limits), found


def of(modes: Any) -> list[Any]:
    """The others are left to the slow run."""
    return [m if m in QUICK else pytest.param(m, marks=pytest.mark.slow) for m in modes]


@pytest.mark.parametrize("shift", [1_000, 100_000])
@pytest.mark.parametrize("mode", of(MODES))
def test_moved_with_its_origin(mode, shift):
    """No bit changes where float32 holds the vertices; else by their roundings alone."""
    assert moved(mode, shift, on_grid=True)[1]
    errors, _ = moved(mode, shift, on_grid=False)
    assert np.isfinite(errors).all()
    if not isinstance(MODES[mode], sr.Hard):
        # A hard image jumps where a vertex is rounded past a sample.
        assert max(errors[:4]) < 10 * float(np.spacing(np.float32(shift)))


@pytest.mark.slow
@pytest.mark.parametrize("mode", LONG_MODES)
def test_long_sums_have_no_bias(mode):
    assert max(long_sum(mode)) < 1e-4


@pytest.mark.parametrize("mode", of(MODES))
def test_an_empty_scene_is_its_background(mode):
    scene = sr.Scene.from_soup(np.zeros((0, 3, 2)), np.zeros((0, 4)), background=[0.5, 0.25, 1.0])
    plan = sr.plan(scene, height=5, width=9, coverage=MODES[mode])
    weight = jnp.asarray(np.random.default_rng(0).normal(size=(5, 9, 3)), jnp.float32)
    direction = moving(scene)
    found = products(scene, plan, stack([direction]), weight, jnp.ones((5, 9)))
    everywhere = np.broadcast_to(scene.background, (5, 9, 3))
    np.testing.assert_array_equal(found.image, everywhere)
    np.testing.assert_array_equal(found.tangents[0], everywhere)
    np.testing.assert_allclose(found.gradient.background, weight.sum((0, 1)), rtol=1e-5)
    np.testing.assert_allclose(found.normal.background[0], 45 * scene.background, rtol=1e-5)
