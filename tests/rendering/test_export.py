"""Programs can be lowered for accelerators that are not present, without callbacks to the host."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import pytest
from jax import export

import softras2d as sr

from ..cases.modes import MODES, QUICK, RICHEST, SIZE, scene_of

PLATFORMS = ("cuda", "tpu")


@pytest.mark.parametrize(
    "name",
    [
        *QUICK[1:],
        *(pytest.param(name, marks=pytest.mark.slow) for name in RICHEST),
    ],
)
def test_images_and_gradients_lower_for_accelerators(name):
    """Programs are only lowered for these platforms, not compiled."""
    mode = MODES[name]
    scene = scene_of(mode.effects)
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=mode.coverage)

    def loss_and_gradient(scene: sr.Scene) -> Any:
        floats, rest = eqx.partition(scene, eqx.is_inexact_array)

        def loss(floats: sr.Scene) -> Any:
            image, overflow = sr.render_checked(eqx.combine(floats, rest), plan)
            return jnp.sum(image**2), overflow

        (value, overflow), gradient = jax.value_and_grad(loss, has_aux=True)(floats)
        return value, overflow, jax.tree.leaves(gradient)

    leaves, structure = jax.tree.flatten(scene)

    def of_leaves(*leaves: Any) -> Any:
        return loss_and_gradient(structure.unflatten(leaves))

    exported = export.export(jax.jit(of_leaves), platforms=PLATFORMS)(*leaves)
    assert exported.platforms == PLATFORMS
    text = exported.mlir_module()
    assert "stablehlo" in text and "callback" not in text
