"""Batches of small scenes, and what is computed from each scene alone."""

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
"""A function from floats of a scene, those of one input or all, to an image."""


class Batch(NamedTuple):
    """A function that draws one scene from its floats, those of several scenes, and tangents.

    - `floats`, `tangents`: trees for `draw`, whose leaves have a leading axis.
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
    """A tree of the same shapes, with seeded normal numbers."""
    rng = np.random.default_rng(seed)
    return jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape), leaf.dtype), tree)


def batch_of(mode: str, name: str | None = None, dtype: type = np.float64, size: int = 2) -> Batch:
    """Scenes that differ in one input, or in all of their floats."""
    scenes = [scene_of(MODES[mode].effects, dtype, seed=seed) for seed in range(size)]
    return batch_from(scenes, plan_of(mode, scenes), name)


def batch_from(scenes: list[sr.Scene], plan: sr.Plan, name: str | None = None) -> Batch:
    """Draw these scenes, whose integers are those of the first, from one input or all floats."""
    first = scenes[0]

    def part(scene: sr.Scene) -> Any:
        return scene if name is None else getattr(scene, name)

    def draw(floats: Any) -> jax.Array:
        changed = eqx.combine(floats, eqx.filter(part(first), eqx.is_inexact_array, inverse=True))
        scene = changed if name is None else eqx.tree_at(part, first, changed)
        return sr.render_checked(scene, plan)[0]

    floats = stack([float_leaves(part(scene)) for scene in scenes])
    return Batch(draw, floats, random_like(floats, seed=5))


def loss(image: jax.Array) -> jax.Array:
    """The mean of the squares of an image."""
    return jnp.mean(image**2)


class OfScene(NamedTuple):
    """What is computed from each scene alone.

    - `gradient`: of the loss.
    - `tangent`: J v, along the tangents of the batch; `normal`: J^T J v.
    """

    gradient: Any
    tangent: Any
    normal: Any


def of_each_scene(batch: Batch) -> OfScene:
    """Compute everything from one scene after another, and stack the results."""

    @jax.jit
    def of_scene(floats: Any, tangents: Any) -> OfScene:
        image, jvp = jax.linearize(batch.draw, floats)
        transpose = jax.linear_transpose(jvp, floats)
        tangent = jvp(tangents)
        return OfScene(transpose(jax.grad(loss)(image))[0], tangent, transpose(tangent)[0])

    return stack([of_scene(*element) for element in batch.elements()])
