"""The state of a fit as arrays by name: enough to go on as if it had never stopped."""

import hashlib
import json
from typing import Any

import equinox as eqx
import jax
import numpy as np
import optimistix as optx

from ..numerics.device import to_device
from .layers.family import Kept, LayersFit
from .mesh.family import Kept as KeptTiling
from .mesh.family import TilingFit
from .mesh.triangulation import Mesh
from .solve import begin

Either = LayersFit | TilingFit


def take(course: Either, steps: int) -> dict[str, np.ndarray]:
    """Of a fit after so many steps: the solver's arrays, and what the host knows."""
    leaves = [leaf for leaf in jax.tree.leaves(_solve(course)) if eqx.is_array(leaf)]
    held = {f"solve.{place}": np.asarray(leaf) for place, leaf in enumerate(leaves)}
    held["steps"] = np.array(steps)
    held["image"] = np.asarray(course.image)
    held["host"] = np.array([course.active, course.exchanged])
    held["target"] = _digest(course.target)
    if course.weights is not None:
        held["weights"] = np.asarray(course.weights)
    if course.kept is not None:
        held["kept"] = np.array(course.kept.least)
        for place, leaf in enumerate(jax.tree.leaves(course.kept.y)):
            held[f"kept.{place}"] = np.asarray(leaf)
    if isinstance(course, TilingFit):
        # With the units of its positions, which are those of an earlier mesh.
        held["scale"] = np.asarray(course.data.scale)
        if course.kept is not None:
            held |= _named("kept.mesh", course.kept.mesh)
            held["kept.scale"] = np.asarray(course.kept.data.scale)
        return held | _named("mesh", course.mesh)
    held["beyond"] = np.array(course.beyond)
    held["width"] = np.asarray(course.data.width)
    held["background"] = np.asarray(course.background)
    drawn = json.dumps(course.rng.bit_generator.state).encode()
    held["random"] = np.frombuffer(drawn, np.uint8)
    return held


def restore(course: Either, held: dict[str, np.ndarray]) -> int:
    """Put a fresh fit with the same settings where `take` was; how many steps those are.

    Raises `ValueError` for the state of another fit.
    """
    if not np.array_equal(held.get("target", []), _digest(course.target)):
        raise ValueError("`resume` is of another `target`.")
    progress, steps = course.progress, int(held["steps"])
    found = _filled(_solve(course), "solve", held)
    if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found[0])):
        raise ValueError("`resume`: `state.solve`: the unknowns must be finite.")
    if isinstance(course.solver, optx.AbstractLeastSquaresSolver):
        y, best = found
        fresh = begin(course.solver, course.residual, y, course.data)
        state = eqx.tree_at(lambda state: (state.best_y, state.best_loss), fresh.state, best)
    else:
        y, state = found
    course.progress = progress._replace(y=y, state=state, steps=steps)
    course.image = held["image"]
    active, course.exchanged = held["host"].tolist()
    course.active = int(active)
    if isinstance(course, LayersFit):
        course.background, course.beyond = held["background"], float(held["beyond"])
        course.data = course.data._replace(
            background=to_device(course.background), width=to_device(held["width"])
        )
        course.rng.bit_generator.state = json.loads(held["random"].tobytes().decode())
        if "kept" in held:
            course.kept = Kept(float(held["kept"]), _filled(y, "kept", held))
    else:
        course.data = course.data._replace(scale=to_device(held["scale"]))
        if "kept" in held:
            mesh = mesh_of(held, "kept.mesh")
            data, y = course.prepare(mesh, held["kept.scale"])
            own = _filled(y, "kept", held)
            course.kept = KeptTiling(float(held["kept"]), own, mesh, data)
    return steps


def layers_length(held: dict[str, Any]) -> int:
    """Triangles in the arrays of a saved fit of layers: as many as asked for, or a size class."""
    return len(held["solve.0"])


def mesh_of(held: dict[str, Any], name: str = "mesh") -> Mesh:
    """The mesh of a fit of one."""
    return Mesh(*(held[f"{name}.{entry}"] for entry in Mesh._fields))


def _solve(course: Either) -> Any:
    """What is kept of a solve. A solver of least squares holds a derivative, a program of its own,
    and begins anew."""
    progress = course.progress
    if isinstance(course.solver, optx.AbstractLeastSquaresSolver):
        return progress.y, (progress.best, progress.least)
    return progress.y, progress.state


def _filled(tree: Any, name: str, held: dict[str, np.ndarray]) -> Any:
    """The tree with saved arrays in the places of its own."""
    leaves, structure = jax.tree.flatten(tree)
    places = [place for place, leaf in enumerate(leaves) if eqx.is_array(leaf)]
    for number, place in enumerate(places):
        entry, own = f"{name}.{number}", leaves[place]
        saved = held.get(entry)
        if saved is None or saved.shape != own.shape or saved.dtype != own.dtype:
            got = "is missing" if saved is None else f"got {saved.dtype} {list(saved.shape)}"
            raise ValueError(
                f"`resume`: `state.{entry}` must be {own.dtype} {list(own.shape)}, of a fit with "
                f"these settings and this solver; {got}."
            )
        leaves[place] = to_device(saved)
    return jax.tree.unflatten(structure, leaves)


def _named(name: str, mesh: Mesh) -> dict[str, np.ndarray]:
    return {f"{name}.{entry}": value for entry, value in mesh._asdict().items()}


def _digest(image: np.ndarray) -> np.ndarray:
    """What tells images apart."""
    told = hashlib.blake2b(np.ascontiguousarray(image, np.float32).tobytes(), digest_size=16)
    return np.frombuffer(told.digest(), np.uint8)
