"""Convert a pytree to a dictionary of named arrays, to save it, and back."""

from typing import Any

import equinox as eqx
import jax
import numpy as np

from ..numerics.device import to_device


def tree_arrays(name: str, tree: Any) -> dict[str, np.ndarray]:
    """Return the arrays of a pytree by the names `name.0`, `name.1`, ..., in the leaves' order.

    Leaves that are not arrays are left out, and are not counted. The order is that of
    `jax.tree.leaves`.
    """
    leaves = [leaf for leaf in jax.tree.leaves(tree) if eqx.is_array(leaf)]
    return {f"{name}.{number}": np.asarray(leaf) for number, leaf in enumerate(leaves)}


def fill_tree(tree: Any, name: str, arrays: dict[str, np.ndarray]) -> Any:
    """Copy a pytree, with its arrays replaced by the arrays `name.0`, `name.1`, ... from `arrays`.

    `arrays`: saved arrays, as `tree_arrays` names them. Raises `ValueError` for an array that is
    missing, or whose shape or type differs from the array in `tree`.
    """
    leaves, structure = jax.tree.flatten(tree)
    array_indices = [index for index, leaf in enumerate(leaves) if eqx.is_array(leaf)]
    for number, index in enumerate(array_indices):
        entry, expected = f"{name}.{number}", leaves[index]
        saved = arrays.get(entry)
        if saved is None or saved.shape != expected.shape or saved.dtype != expected.dtype:
            got = "is missing" if saved is None else f"got {saved.dtype} {list(saved.shape)}"
            raise ValueError(
                f"`resume`: `state.{entry}` must be {expected.dtype} {list(expected.shape)}, of a "
                f"fit with these settings and this solver; {got}."
            )
        leaves[index] = to_device(saved)
    return jax.tree.unflatten(structure, leaves)
