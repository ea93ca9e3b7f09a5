"""The state of a fit as arrays by name: enough to go on as if it had never stopped."""

import json
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .layers_fit import LayersFit
from .tiling_fit import TilingFit
from .triangulation import Mesh

Course = LayersFit | TilingFit


def take(course: Course, steps: int) -> dict[str, np.ndarray]:
    """Of a fit after so many steps: the solver's arrays, and what the host knows."""
    solve = (course.progress.y, course.progress.state)
    leaves = [leaf for leaf in jax.tree.leaves(solve) if eqx.is_array(leaf)]
    held = {f"solve.{place}": np.asarray(leaf) for place, leaf in enumerate(leaves)}
    held["steps"] = np.array(steps)
    held["image"] = np.asarray(course.image)
    held["host"] = np.array([course.active, course.exchanged])
    if isinstance(course, TilingFit):
        # With the units of its positions, which are those of an earlier mesh.
        held["scale"] = np.asarray(course.data.scale)
        return held | {f"mesh.{name}": value for name, value in course.mesh._asdict().items()}
    held["background"] = np.asarray(course.background)
    drawn = json.dumps(course.rng.bit_generator.state).encode()
    held["random"] = np.frombuffer(drawn, np.uint8)
    return held


def restore(course: Course, held: dict[str, np.ndarray]) -> int:
    """Put a fresh fit with the same settings where `take` was; how many steps those are."""
    progress = course.progress
    leaves, structure = jax.tree.flatten((progress.y, progress.state))
    places = [place for place, leaf in enumerate(leaves) if eqx.is_array(leaf)]
    for number, place in enumerate(places):
        saved = held.get(f"solve.{number}")
        if saved is None or saved.shape != leaves[place].shape:
            raise ValueError("`resume` holds no state of a fit with these settings.")
        leaves[place] = jnp.asarray(saved)
    y, state = jax.tree.unflatten(structure, leaves)
    steps = int(held["steps"])
    course.progress = progress._replace(y=y, state=state, steps=steps)
    course.image = held["image"]
    active, course.exchanged = held["host"].tolist()
    course.active = int(active)
    if isinstance(course, LayersFit):
        course.background = held["background"]
        course.data = course.data._replace(background=jnp.asarray(course.background))
        course.rng.bit_generator.state = json.loads(held["random"].tobytes().decode())
    else:
        course.data = course.data._replace(scale=jnp.asarray(held["scale"]))
    return steps


def mesh_of(held: dict[str, Any]) -> Mesh:
    """The mesh of a fit of one."""
    return Mesh(*(held[f"mesh.{name}"] for name in Mesh._fields))
