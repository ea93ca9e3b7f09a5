"""Derivatives of triangles without area are bounded and continuous, and jvp equals vjp."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..cases.products import float_leaves, products, stack
from ..cases.stability_degenerate import (
    MODES,
    SIZE,
    WIDTHS,
    collapse,
    corners_of_kind,
    derive,
    measure,
    plan_of,
    scene_of,
    within,
)

SLOW = pytest.mark.slow
QUICK = ("soft logistic", "area")


@pytest.mark.parametrize(
    "mode", [mode if mode in QUICK else pytest.param(mode, marks=SLOW) for mode in MODES]
)
def test_derivatives_agree_and_are_bounded(mode):
    widths = (1.0,) if mode in QUICK else WIDTHS
    for row in measure(mode, widths=widths, random=1):
        assert within(row), row


SHADED_SUM = pytest.param("sum, shaded", marks=SLOW)


@pytest.mark.parametrize("mode", ["soft logistic", "area", SHADED_SUM])
def test_a_triangle_collapses_without_a_jump(mode):
    """Image and derivatives are continuous as a triangle of either orientation loses its area.

    Differences are relative to the numbers of a triangle one pixel high, so that one limit is right
    for all scenes.
    """
    for row in collapse(mode):
        assert row["value"] < 2e-5, row
        close = 0.03 if row["case"] == "by the origin" else 0.15
        assert row["gradient"] < close, row
        assert row["jvp"] < close, row
        assert row["largest"] < 4, row


def test_a_segment_has_a_gradient_at_its_ends_alone():
    """The gradient is that of the distance to the segment, which depends only on its ends.

    The corner between the ends has almost no gradient, and moving this corner along the segment
    hardly changes the gradients of the ends.
    """
    coverage, effects = MODES["soft logistic"]
    scene, plan = scene_of(effects), plan_of(coverage, effects)
    (corners,) = corners_of_kind("third between", random=1)[-1:]
    middle = corners.copy()
    middle[2] = 0.3 * corners[0] + 0.7 * corners[1]
    derivatives, other = (derive(scene, plan, triangle) for triangle in (corners, middle))
    scale = np.abs(derivatives.gradient).max()
    assert scale > 1e-2
    assert np.abs(derivatives.gradient[2]).max() < 0.1 * scale
    np.testing.assert_allclose(derivatives.gradient[:2], other.gradient[:2], atol=0.1 * scale)


def test_three_equal_corners_share_the_gradient_equally():
    coverage, effects = MODES["soft logistic"]
    scene, plan = scene_of(effects), plan_of(coverage, effects)
    gradient = derive(scene, plan, np.full((3, 2), 6.3, np.float32)).gradient
    assert np.abs(gradient).max() > 1e-3
    np.testing.assert_allclose(gradient, np.broadcast_to(gradient.mean(0), (3, 2)), rtol=1e-4)


EXTREMES = {
    "depth 1e7": ("gd", 1e7, 1.0),
    "depth 1e30": ("gd", 1e30, 1.0),
    "colors 1e20": ("ga", 1.0, 1e20),
    "colors 1e30": ("ga", 1.0, 1e30),
    "both 1e30": ("gad", 1e30, 1e30),
    "textured, both 1e20": ("gatd", 1e20, 1e20),
}


@functools.cache
def _plan(effects: str, temperature: float) -> sr.Plan:
    return plan_of(sr.Soft(1.0, temperature=temperature), effects)


@pytest.mark.parametrize("temperature", [0.01, pytest.param(1e-6, marks=SLOW)])
@pytest.mark.parametrize("name", [pytest.param(name, marks=SLOW) for name in EXTREMES])
def test_jvp_equals_vjp_for_depth_and_colors_of_any_size(name, temperature):
    """The loss is linear in the image, since squares of such colours would overflow."""
    effects, depth, color = EXTREMES[name]
    scene = scene_of(effects, depth=depth, color=color)
    rng = np.random.default_rng(2)
    weight = jnp.asarray(rng.normal(size=(SIZE, SIZE, 3)), jnp.float32)
    direction: Any = jax.tree.map(
        lambda leaf: jnp.asarray(rng.normal(size=leaf.shape), leaf.dtype), float_leaves(scene)
    )
    ones = jnp.ones((SIZE, SIZE))
    result = products(scene, _plan(effects, temperature), stack([direction]), weight, ones)
    for leaf in jax.tree.leaves((result.image, result.tangents, result.gradient)):
        assert np.isfinite(leaf).all()
    tangent = np.asarray(result.tangents[0], np.float64)
    pairs = zip(jax.tree.leaves(result.gradient), jax.tree.leaves(direction), strict=True)
    backward = sum(float((np.asarray(g, np.float64) * v).sum()) for g, v in pairs)
    forward = float((tangent * weight).sum())
    assert forward == pytest.approx(backward, abs=1e-4 * float(np.abs(tangent * weight).sum()))
    if color == 1:
        # The depth of a triangle does not change how much its colour can change a pixel.
        assert np.abs(result.gradient.positions).max() < 100
