"""What triangles carry, on hard ground: finite, within a stated error, and none harms another."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ..cases.derivatives import backward
from ..cases.stability_attributes import (
    CASES,
    COUNT,
    MODES,
    SIZE,
    TEXTURED,
    WILD,
    carrying,
    measure,
    planned,
)

SLOW = pytest.mark.slow


@SLOW
@pytest.mark.parametrize(
    "mode, name", [(mode, name) for mode in MODES for name in CASES if mode in CASES[name]().modes]
)
def test_within_stated_errors(mode, name):
    case = CASES[name]()
    found = measure(case, mode)
    assert found.within(case.limits), found


@SLOW
@pytest.mark.parametrize("mode", ["soft", "area"])
def test_a_wild_triangle_harms_no_other(mode):
    """No bit of its gradient changes from the scene in which the wild one lies off the canvas."""
    away = carrying()
    away.corners[WILD] += 1e5
    weight = jnp.asarray(np.random.default_rng(9).normal(size=(SIZE, SIZE, 3)), jnp.float32)
    gradient, expected = (
        backward(*planned(case, mode), weight)[0] for case in (CASES["NaN"](), away)
    )
    for a, b in zip(jax.tree.leaves(gradient), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(a, b)
    for name in ("positions", "colors", "uv", "inverse_w"):
        own = np.asarray(getattr(gradient, name)).reshape(COUNT, -1)
        assert not own[WILD].any()
        # Where no texture is read, where it would be does not matter.
        drawn = (np.arange(COUNT) != WILD) & ((name != "uv") | (TEXTURED >= 0))
        assert own[drawn].any(1).all()
