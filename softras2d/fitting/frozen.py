"""Unknowns that a solver must not change: frozen by the user, or colours that a palette decides.

The solver still changes its copy of them, but without effect: wherever a scene is made from
unknowns, the frozen ones are replaced by fixed values. Masks and fixed values are part of the
`data` that a residual takes, so that they can change between chunks without compiling again.
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
"""For each vertex, triangle or entry of an array, whether it is frozen."""


class Frozen(NamedTuple):
    """Which unknowns are frozen, and their fixed values.

    - `masks`: one boolean array for each leaf of the unknowns, in the order of `jax.tree.leaves`,
      true where a number is frozen. It has as many axes as the leaf; an axis of length 1 is
      broadcast.
    - `values`: a pytree like the unknowns, of which only the numbers where a mask is true are used.
    """

    masks: tuple[Bool[Array, "..."], ...]
    values: Any


def with_frozen(y: Any, frozen: Frozen | None) -> Any:
    """Replace the frozen numbers in the unknowns `y` by their fixed values; their gradient is 0.

    If `frozen` is None, `y` is returned unchanged.
    """
    if frozen is None:
        return y
    leaves, structure = jax.tree.flatten(y)
    values = jax.tree.leaves(frozen.values)
    return structure.unflatten(
        jnp.where(mask, value, leaf)
        for mask, value, leaf in zip(frozen.masks, values, leaves, strict=True)
    )


def freeze(y: Any, masks: Mapping[str, bool | Mask]) -> Frozen:
    """Freeze some of the unknowns `y`, a named tuple of arrays, at their values in `y`.

    `masks`: for the name of a field of `y`, either True, which freezes the field, or a mask along
    its first axis. If a mask is shorter than the field, the entries after the mask are not frozen.
    A field without a mask is not frozen. Fields that are None are skipped.
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
    """Return a scene with the exact positions that some triangles had in an earlier scene.

    During a fit, these positions are converted to other units, which changes them by rounding
    errors.

    - `scene`: its triangle k has the vertices 3 k, 3 k + 1 and 3 k + 2.
    - `earlier`: a scene with the same triangles, in the same unit; its triangles may share
      vertices.
    - `triangles`: true for each triangle whose corners are taken from `earlier`.
    """
    corners = np.asarray(scene.positions).reshape(-1, 3, 2)
    before = np.asarray(earlier.positions)[np.asarray(earlier.triangles)]
    corners = np.where(triangles[:, None, None], before.astype(np.float32), corners)
    return replace(scene, positions=to_device(corners.reshape(-1, 2)))
