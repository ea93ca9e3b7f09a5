"""Unknowns that a solver must not change: frozen ones, and colours that a palette decides.

The solver still sees them, but what it does to them has no effect: wherever a scene is made from
unknowns, the frozen ones are replaced by fixed values. Masks and values are arrays of the data of a
residual, so that they can change between chunks without compiling again.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool

from ..numerics.device import to_device
from ..scene import Scene

Mask = Bool[np.ndarray, " n"]


class Frozen(NamedTuple):
    """Which unknowns are frozen, and their values.

    - `masks`: for each leaf of the unknowns, in the order of `jax.tree.leaves`, whether its numbers
      are frozen; of the rank of the leaf, with axes of length 1 for all alike.
    - `values`: a pytree like the unknowns; only its frozen numbers matter.
    """

    masks: tuple[Bool[Array, "..."], ...]
    values: Any


def with_frozen(y: Any, frozen: Frozen | None) -> Any:
    """The unknowns with the frozen ones at their fixed values, and with no gradient by those."""
    if frozen is None:
        return y
    leaves, structure = jax.tree.flatten(y)
    values = jax.tree.leaves(frozen.values)
    return structure.unflatten(
        jnp.where(mask, value, leaf)
        for mask, value, leaf in zip(frozen.masks, values, leaves, strict=True)
    )


def freeze(y: Any, masks: Mapping[str, bool | Mask]) -> Frozen:
    """Freeze unknowns at their values in `y`.

    `masks`: for a field of the unknowns, whether it is frozen, as a whole or for each entry along
    its first axis. A mask may be shorter than the field; the entries after it are not frozen.
    """
    arrays = []
    for name, leaf in y._asdict().items():
        if leaf is None:
            continue
        mask = masks.get(name, False)
        array = np.full((1,) * leaf.ndim, mask is True)
        if isinstance(mask, np.ndarray):
            array = np.zeros((len(leaf), *(1,) * (leaf.ndim - 1)), bool)
            array[: len(mask)] = mask.reshape(-1, *array.shape[1:])
        arrays.append(to_device(array))
    return Frozen(tuple(arrays), y)


def with_exact_positions(
    scene: Scene, earlier: Scene, triangles: Bool[np.ndarray, " triangles"]
) -> Scene:
    """Give triangles that share no vertices the very corners that they had in an earlier scene.

    Units of the unknowns, and a fit smaller than its target, change a position by a rounding error.
    `triangles`: which of them have not moved.
    """
    corners = np.asarray(scene.positions).reshape(-1, 3, 2)
    before = np.asarray(earlier.positions)[np.asarray(earlier.triangles)]
    corners = np.where(triangles[:, None, None], before.astype(np.float32), corners)
    return replace(scene, positions=to_device(corners.reshape(-1, 2)))
