"""The losses of all windows add up to the loss of the whole canvas, and so do the gradients."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..cases.tiled import HEIGHT, TILE, WIDTH, scene_of

CASES = {
    "hard": (sr.Hard(4), "corners"),
    "hard layers": (sr.Hard(4), "alpha depth"),
    "soft": (sr.Soft(1.5), "alpha depth"),
    "area": (sr.Area(), "texture"),
}


def squared(image: Any, target: Any) -> Any:
    return jnp.sum((image - target) ** 2)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_the_gradient_of_all_windows_is_that_of_the_canvas(name):
    """Windows have a border, so hard edges between two windows are counted too."""
    coverage, effects = CASES[name]
    scene = scene_of(effects)
    target = np.random.default_rng(1).random((HEIGHT, WIDTH, 3)).astype(np.float32)
    canvas_plan = sr.plan(scene, height=HEIGHT, width=WIDTH, coverage=coverage)
    value, gradient = eqx.filter_jit(
        eqx.filter_value_and_grad(lambda s: squared(sr.render(s, canvas_plan), target))
    )(scene)
    plan = sr.plan_tiles(
        scene, height=HEIGHT, width=WIDTH, coverage=coverage, tile=96, gradients=True
    )
    tiled_value, tiled = sr.tiled_value_and_grad(squared)(scene, plan, target)
    assert abs(tiled_value / float(value) - 1) < 1e-5
    names = [n for n in ("positions", "colors", "background", "uv", "depth")
             if getattr(scene, n) is not None]  # fmt: skip
    for n in names:
        expected, actual = (np.asarray(getattr(g, n)) for g in (gradient, tiled))
        scale = np.abs(expected).max()
        assert scale > 0
        assert np.abs(actual - expected).max() <= 1e-5 * scale, n
    assert TILE < 96 and tiled.triangles is None


def test_data_of_another_size_is_refused():
    scene = scene_of()
    plan = sr.plan_tiles(scene, height=HEIGHT, width=WIDTH, tile=TILE, gradients=True)
    with pytest.raises(ValueError, match=r"data must be \[100, 150"):
        sr.tiled_value_and_grad(squared)(scene, plan, np.zeros((3, 4, 3)))
