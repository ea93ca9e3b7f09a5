"""Many arrays with a common last axis, packed so that an entry of all of them is gathered at once.

A loop that gathers a few entries from a dozen arrays in each step spends most of its time on the
gathers. Packed, the integers of an entry lie side by side in one row, and so do its floats.
"""

import functools
import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .fusion_barrier import materialized
from .one_core import on_one_core


class _Layout(NamedTuple):
    """Structure of a tree, and the shape without the last axis and the dtype of each leaf."""

    structure: Any
    shapes: tuple[tuple[int, ...], ...]
    dtypes: tuple[Any, ...]


class Columns(eqx.Module):
    """A tree of arrays `[..., entries]`, packed into one array of integers and one of floats.

    An array is None if the tree has no numbers of its kind. Booleans are stored as integers, 0 or
    1. `layout` says how the tree is rebuilt.
    """

    integers: Int[Array, "integers entries"] | None
    floats: Float[Array, "floats entries"] | None
    layout: _Layout = eqx.field(static=True)

    def unpack(self) -> Any:
        """Return the tree of arrays `[..., entries]`, with its original dtypes.

        To be called where the arrays are used, so that the compiler does not copy them.
        """
        leaves, used = [], [0, 0]
        for shape, dtype in zip(self.layout.shapes, self.layout.dtypes, strict=True):
            is_float = jnp.issubdtype(dtype, jnp.floating)
            fields = self.floats if is_float else self.integers
            assert fields is not None
            first = used[is_float]
            used[is_float] = first + math.prod(shape)
            leaves.append(fields[first : used[is_float]].reshape(*shape, -1).astype(dtype))
        return jax.tree.unflatten(self.layout.structure, leaves)


class Rows(eqx.Module):
    """A tree of arrays `[..., entries]`, as one row of integers and one of floats for each entry.

    `integers` or `floats` is None if the tree has no numbers of this kind. Booleans are stored as
    integers, 0 or 1. `layout` says how the tree is rebuilt.
    """

    integers: Int[Array, "entries integers"] | None
    floats: Float[Array, "entries floats"] | None
    layout: _Layout = eqx.field(static=True)

    def gather(
        self, index: Int[Array, " gathered"], step: Int[Array, ""], *, repeats: int
    ) -> Columns:
        """Gather the entries at `index` on one core, and repeat each of them `repeats` times.

        The repetitions of an entry follow each other in the result. An index past the last entry
        stands for the last. `step` is any traced integer, such as a loop's counter (`on_one_core`).
        """
        gather = functools.partial(_gather_columns, index=index, step=step, repeats=repeats)
        integers = None if self.integers is None else gather(self.integers)
        floats = None if self.floats is None else gather(self.floats)
        return Columns(integers, floats, self.layout)


@materialized
def pack_rows(tree: Any) -> Rows:
    """Pack a tree of arrays `[..., entries]`, which are int32, booleans or floats, into `Rows`.

    All floats are stored in the widest of their dtypes.
    """
    leaves, structure = jax.tree.flatten(tree)
    layout = _Layout(
        structure, tuple(leaf.shape[:-1] for leaf in leaves), tuple(leaf.dtype for leaf in leaves)
    )
    floats = [leaf for leaf in leaves if jnp.issubdtype(leaf.dtype, jnp.floating)]
    integers = [leaf for leaf in leaves if not jnp.issubdtype(leaf.dtype, jnp.floating)]
    widest = max((leaf.dtype for leaf in floats), key=lambda dtype: dtype.itemsize, default=None)
    return Rows(
        _join(integers, jnp.int32) if integers else None,
        _join(floats, widest) if floats else None,
        layout,
    )


def _join(leaves: list[Array], dtype: Any) -> Array:
    """Put arrays `[..., entries]` side by side, as `[entries, fields]`."""
    return jnp.concatenate([x.reshape(-1, x.shape[-1]).astype(dtype) for x in leaves]).T


@functools.partial(materialized, static_argnames=("repeats",))
def _gather_columns(
    rows: Array, index: Int[Array, " gathered"], step: Int[Array, ""], *, repeats: int
) -> Array:
    """Gather rows of one array on one core, transpose them, and repeat each column."""
    gathered = on_one_core(_take, step, rows, index)
    return materialized(lambda gathered: jnp.repeat(gathered.T, repeats, 1))(gathered)


def _take(rows: Array, index: Int[Array, " gathered"]) -> Array:
    """Gather the rows at `index`."""
    return rows.at[index].get(mode="clip")
