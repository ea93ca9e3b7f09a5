"""Unknowns that a solver must not change: frozen ones, and colours that a palette decides.

The solver still sees them, but what it does to them has no effect: wherever a scene is made from
unknowns, the frozen ones are replaced by fixed values. Masks and values are arrays of the data of a
residual, so that they can change between chunks without compiling again.
"""

from collections.abc import Collection
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .trees import tree_arrays


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


def masks_of_fields(y: Any, names: Collection[str]) -> tuple[Bool[np.ndarray, "..."], ...]:
    """Masks that freeze whole fields of the unknowns, those of these names."""
    fields = {name: leaf for name, leaf in y._asdict().items() if leaf is not None}
    return tuple(np.full((1,) * leaf.ndim, name in names) for name, leaf in fields.items())


def steered_arrays(
    palette: Float[np.ndarray, "colors 3"] | None, frozen: Frozen | None
) -> dict[str, np.ndarray]:
    """The arrays that a fit with a palette or with frozen unknowns saves."""
    arrays = {} if palette is None else {"palette": palette}
    return arrays if frozen is None else arrays | tree_arrays("frozen", frozen.values)
