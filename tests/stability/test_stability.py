"""Images and derivatives of numerically hard scenes are finite, and close to float64.

`python -m experiments.stability.run` makes the same measurements and prints the table.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..cases.products import float_leaves, products, stack
from ..cases.stability_cases import CASES, MODES
from ..cases.stability_measure import LONG_MODES, long_sum, measure, moved

QUICK = ("soft", "area")
"""Modes that are tested in the quick run."""

LONG = ("one pixel", "1000 layers")
"""Cases that need separate programs, and are left to the slow run."""


def parameter(mode: str, case: str) -> Any:
    """A test parameter of a mode and a case, left to the slow run unless it is quick."""
    marks = [] if mode in QUICK and case not in LONG else [pytest.mark.slow]
    return pytest.param(mode, case, marks=marks, id=f"{mode}-{case}")


@pytest.mark.parametrize(
    "mode, name",
    [parameter(mode, name) for mode in MODES for name in CASES if mode in CASES[name]().modes],
)
def test_errors_are_within_those_stated(mode, name):
    case = CASES[name]()
    errors = measure(case, mode)
    assert errors.within(case.limits), errors


def marked(modes: Any) -> list[Any]:
    """Test parameters of modes. Modes that are not in `QUICK` are left to the slow run."""
    return [m if m in QUICK else pytest.param(m, marks=pytest.mark.slow) for m in modes]


@pytest.mark.parametrize("shift", [1_000, 100_000])
@pytest.mark.parametrize("mode", marked(MODES))
def test_moving_a_scene_with_its_origin_changes_only_roundings(mode, shift):
    """No bit changes if float32 represents the moved vertices exactly.

    Otherwise errors are at most ten times the distance between neighbouring floats near the shift.
    """
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


@pytest.mark.parametrize("mode", marked(MODES))
def test_an_empty_scene_is_its_background(mode):
    scene = sr.Scene.from_soup(np.zeros((0, 3, 2)), np.zeros((0, 4)), background=[0.5, 0.25, 1.0])
    plan = sr.plan(scene, height=5, width=9, coverage=MODES[mode])
    weight = jnp.asarray(np.random.default_rng(0).normal(size=(5, 9, 3)), jnp.float32)
    direction = float_leaves(scene)
    result = products(scene, plan, stack([direction]), weight, jnp.ones((5, 9)))
    everywhere = np.broadcast_to(scene.background, (5, 9, 3))
    np.testing.assert_array_equal(result.image, everywhere)
    np.testing.assert_array_equal(result.tangents[0], everywhere)
    np.testing.assert_allclose(result.gradient.background, weight.sum((0, 1)), rtol=1e-5)
    np.testing.assert_allclose(result.normal.background[0], 45 * scene.background, rtol=1e-5)
