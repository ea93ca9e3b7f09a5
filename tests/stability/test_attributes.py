"""Images and derivatives of hard scenes with vertex attributes are finite and accurate.

A triangle with a NaN corner does not affect the derivatives of others.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from ..cases.derivatives import backward
from ..cases.stability_attributes import (
    CASES,
    COUNT,
    MODES,
    NOT_FINITE,
    SIZE,
    TEXTURE_INDEX,
    measure,
    scene_and_plan,
    with_attributes,
)

SLOW = pytest.mark.slow


@SLOW
@pytest.mark.parametrize(
    "mode, name", [(mode, name) for mode in MODES for name in CASES if mode in CASES[name]().modes]
)
def test_errors_are_within_those_stated(mode, name):
    case = CASES[name]()
    errors = measure(case, mode)
    assert errors.within(case.limits), errors


@SLOW
@pytest.mark.parametrize("mode", ["soft", "area"])
def test_a_nan_corner_changes_no_other_triangles_gradient(mode):
    """The gradients of other triangles have the same bits as if this one were off the canvas."""
    off_canvas = with_attributes()
    off_canvas.corners[NOT_FINITE] += 1e5
    weight = jnp.asarray(np.random.default_rng(9).normal(size=(SIZE, SIZE, 3)), jnp.float32)
    gradient, expected = (
        backward(*scene_and_plan(case, mode), weight)[0] for case in (CASES["NaN"](), off_canvas)
    )
    for a, b in zip(jax.tree.leaves(gradient), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(a, b)
    for name in ("positions", "colors", "uv", "inverse_w"):
        by_triangle = np.asarray(getattr(gradient, name)).reshape(COUNT, -1)
        assert not by_triangle[NOT_FINITE].any()
        # A triangle without a texture has no gradient with respect to uv.
        drawn = (np.arange(COUNT) != NOT_FINITE) & ((name != "uv") | (TEXTURE_INDEX >= 0))
        assert by_triangle[drawn].any(1).all()
