"""Batches of small scenes, and the derivatives of each scene when it is drawn alone."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import softras2d as sr

from .modes import MODES, plan_of, scene_of
from .products import float_leaves, stack

Draw = Callable[[Any], jax.Array]
"""Maps floating-point arrays of a scene, of one input or of all, to an image."""


class Batch(NamedTuple):
    """Several scenes that one function draws, and a tangent for each.

    - `draw`: draws one scene from its floating-point arrays.
    - `floats`: the arguments of `draw` for all scenes, stacked along a leading axis.
    - `tangents`: random directions, of the structure of `floats`.
    """

    draw: Draw
    floats: Any
    tangents: Any

    @property
    def size(self) -> int:
        return len(jax.tree.leaves(self.floats)[0])

    def elements(self) -> list[tuple[Any, Any]]:
        """The floats and tangents of each scene."""
        pair = (self.floats, self.tangents)
        return [jax.tree.map(lambda leaf, at=at: leaf[at], pair) for at in range(self.size)]


def random_like(tree: Any, seed: int) -> Any:
    """A tree of the same structure and shapes, with seeded normal numbers."""
    rng = np.random.default_rng(seed)
    return jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape), leaf.dtype), tree)


def batch_of(mode: str, name: str | None = None, dtype: type = np.float64, size: int = 2) -> Batch:
    """A batch of scenes of a mode that differ in the input `name`, or in all floats if None."""
    scenes = [scene_of(MODES[mode].effects, dtype, seed=seed) for seed in range(size)]
    return batch_from(scenes, plan_of(mode, scenes), name)


def batch_from(scenes: list[sr.Scene], plan: sr.Plan, name: str | None = None) -> Batch:
    """A batch of the given scenes, which differ in the input `name`, or in all floats if None.

    Everything else is taken from the first scene.
    """
    first = scenes[0]

    def varied_input(scene: sr.Scene) -> Any:
        return scene if name is None else getattr(scene, name)

    def draw(floats: Any) -> jax.Array:
        changed = eqx.combine(
            floats, eqx.filter(varied_input(first), eqx.is_inexact_array, inverse=True)
        )
        scene = changed if name is None else eqx.tree_at(varied_input, first, changed)
        return sr.render_checked(scene, plan)[0]

    floats = stack([float_leaves(varied_input(scene)) for scene in scenes])
    return Batch(draw, floats, random_like(floats, seed=5))


def loss(image: jax.Array) -> jax.Array:
    """The mean of the squares of an image."""
    return jnp.mean(image**2)


class OfScene(NamedTuple):
    """Derivatives of each scene, computed without a batch and then stacked.

    - `gradient`: gradient of `loss` of the image.
    - `tangent`: J v, the tangent of the image along the tangents v of the batch.
    - `normal`: J^T J v.
    """

    gradient: Any
    tangent: Any
    normal: Any


def of_each_scene(batch: Batch) -> OfScene:
    """Compute the derivatives of one scene after another, and stack them."""

    @jax.jit
    def of_scene(floats: Any, tangents: Any) -> OfScene:
        image, jvp = jax.linearize(batch.draw, floats)
        transpose = jax.linear_transpose(jvp, floats)
        tangent = jvp(tangents)
        return OfScene(transpose(jax.grad(loss)(image))[0], tangent, transpose(tangent)[0])

    return stack([of_scene(*element) for element in batch.elements()])
