"""`without_effect` removes one effect from a scene, and `price_effects` measures every effect."""

from dataclasses import replace

import numpy as np
import pytest

import softras2d as sr
from softras2d.planning.effects import EFFECTS
from softras2d.rendering.cost import price_effects, without_effect


def _scene() -> sr.Scene:
    """A scene with every effect, and a triangle past the guard band."""
    corners = np.array([[(0, 0), (9, 0), (0, 9)], [(0, 0), (99, 0), (0, 9)]], np.float32)
    image = np.random.default_rng(0).random((4, 4, 4)).astype(np.float32)
    return sr.Scene.from_soup(
        corners,
        np.linspace(0, 1, 24, dtype=np.float32).reshape(2, 3, 4),
        uv=np.ones((2, 3, 2)),
        texture_index=[0, -1],
        textures=sr.TexturePyramid.build([image]),
        depth=np.zeros((2, 3)),
        inverse_w=np.ones((2, 3)),
        background=[1, 1, 1, 0],
    )


def _plan(scene: sr.Scene) -> sr.Plan:
    return sr.plan(
        scene,
        height=9,
        width=9,
        coverage=sr.Hard(samples=4, shading="pixel"),
        filter=sr.Filter(anisotropy=2, lod_bias=0.5),
        origin=(0, 1),
    )


ANALYTIC = {"soft coverage": sr.Soft(), "exact area": sr.Area()}


@pytest.mark.parametrize("effect", [name for name in EFFECTS if name not in ANALYTIC])
def test_without_removes_that_effect_alone(effect):
    scene = _scene()
    plan = _plan(scene)
    assert set(plan.effects) == set(EFFECTS) - set(ANALYTIC)
    _, reduced = without_effect(scene, plan, effect)
    removed = set(plan.effects) - set(reduced.effects)
    # Removing textures also removes their filters and mip levels.
    of_textures = {"mip levels", "bilinear filter", "anisotropic filter"}
    assert effect in removed
    assert removed - {effect} <= (of_textures if effect == "texture" else set())
    assert (reduced.height, reduced.width, reduced.coverage.rate) == (9, 9, 2)
    np.testing.assert_array_equal(reduced.origin, [0, 1])
    assert float(reduced.filter.lod_bias) == 0.5


@pytest.mark.parametrize("effect", ANALYTIC)
def test_without_analytic_coverage_is_one_hard_sample(effect):
    scene = replace(_scene(), depth=None)
    plan = sr.plan(scene, height=9, width=9, coverage=ANALYTIC[effect])
    _, reduced = without_effect(scene, plan, effect)
    assert reduced.coverage.rate == 1
    assert set(plan.effects) - set(reduced.effects) == {effect}


def test_an_unknown_effect_is_refused():
    scene = _scene()
    with pytest.raises(ValueError, match="glow"):
        without_effect(scene, _plan(scene), "glow")


@pytest.mark.slow
def test_prices_are_positive_and_less_without_interpolated_colour():
    scene = sr.Scene.from_soup(
        [[(0, 0), (9, 0), (0, 9)]], np.eye(3, dtype=np.float32)[None], background=[1, 1, 1, 0]
    )
    plan = sr.plan(scene, height=9, width=9, coverage=sr.Hard(samples=1))
    rows = list(price_effects(scene, plan, repeats=1))
    assert [effect for effect, _, _ in rows] == [None, *plan.effects]
    assert rows[0][1] == rows[0][2]
    for _, complete, reduced in rows:
        for price in (complete, reduced):
            assert price.seconds > 0 and price.memory > 0
            assert price.operations > 0 and price.traffic > 0
    flat = rows[1 + plan.effects.index("interpolated colour")]
    assert flat[2].operations < flat[1].operations
