"""Inclusive prefix sums and maxima of integers.

`jnp.cumsum` becomes a tree of window reductions on the CPU, which take longer to compile and to
run. Here a vector is scanned in doubling steps. A vector of more than 32,768 entries is split into
rows of 64. Each row is scanned in six steps, then the vector of their last entries is scanned as
one row, and each row is combined with the total of all rows before it.

**Source:** Hillis and Steele, *Data Parallel Algorithms* (CACM 29(12), 1986), "Sum of an array".
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

_ROW = 64
"""Number of entries in a row of a long vector."""

_SHORT = 2**15
"""Greatest length of a vector that is scanned as one row. One loop takes half as long to compile as
two, and its additional steps are cheap while the vector fits the cache."""


def cumulative_sum(x: Int[Array, " n"]) -> Int[Array, " n"]:
    """Inclusive prefix sum: entry i of the result is x[0] + ... + x[i], wrapped to x's dtype."""
    return _scan(x, jnp.add)


def list_flagged(
    flags: Bool[Array, " n"], *, capacity: int
) -> tuple[Int[Array, " capacity"], Int[Array, ""]]:
    """List the indices of the flags that are true, in ascending order, and count them.

    Returns the list, of length `capacity`, and the number of true flags. Entries of the list after
    the last index are `n`, the number of all flags. `capacity` must be `n` or more, and `n` must
    not be 0.
    """
    size = flags.shape[0]
    end = cumulative_sum(flags.astype(jnp.int32))
    index = jnp.where(flags, end - 1, capacity)
    numbers = jnp.arange(size, dtype=jnp.int32)
    return jnp.full(capacity, size, jnp.int32).at[index].set(numbers, mode="drop"), end[-1]


def cumulative_max(x: Int[Array, " n"]) -> Int[Array, " n"]:
    """Inclusive prefix maximum: entry i of the result is the greatest of x[0], ..., x[i].

    All entries must be 0 or more.
    """
    return _scan(x, jnp.maximum)


def _scan(x: Array, join: Callable[[Array, Array], Array]) -> Array:
    """Inclusive prefix scan: combine the entries x[0], ..., x[i] by `join`, for every i.

    `join` is associative and elementwise, and its neutral element is 0.
    """
    count = x.shape[0]
    if count <= _SHORT:
        return _scan_rows(x[None], join)[0]
    rows = -(-count // _ROW)
    table = jnp.pad(x, (0, rows * _ROW - count)).reshape(rows, _ROW)
    table = _scan_rows(table, join)
    before = jnp.pad(_scan_rows(table[:, -1][None], join)[0, :-1], (1, 0))
    return join(table, before[:, None]).reshape(-1)[:count]


def _scan_rows(table: Array, join: Callable[[Array, Array], Array]) -> Array:
    """Inclusive prefix scan of each row of a table, in doubling steps.

    Each entry of a row is combined with the entry 1 before it, then with the entry 2 before it,
    then 4, and so on.
    """
    length = table.shape[1]
    zeros = jnp.zeros_like(table)

    def step(k: Array, table: Array) -> Array:
        padded = jnp.concatenate([zeros, table], 1)
        return join(table, jax.lax.dynamic_slice_in_dim(padded, length - (1 << k), length, 1))

    return jax.lax.fori_loop(0, (length - 1).bit_length(), step, table)
