"""Expansion: one entry for each of the things that every owner has, in one list.

If owner i has `count[i]` things, the list names owner 0 `count[0]` times, then owner 1, and so on,
with ranks from 0 within each owner. On the device the list has a fixed capacity; on the host it is
as long as it needs to be. `pairs.find_pairs` is written for both.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from ..numerics.array_types import HostOrDeviceArray
from ..numerics.prefix import cumulative_max, cumulative_sum


class Expansion(NamedTuple):
    """The entries of an expanded list.

    - `owner`, `rank`: the owner of each entry, and the entry's number among those of its owner.
    - `is_used`: whether there is such an entry; false beyond `total`.
    - `total`: the sum of the counts. If it exceeds the capacity, entries are missing.
    """

    owner: Int[HostOrDeviceArray, " entries"]
    rank: Int[HostOrDeviceArray, " entries"]
    is_used: Bool[HostOrDeviceArray, " entries"]
    total: Int[HostOrDeviceArray, ""]


Expand = Callable[[HostOrDeviceArray], Expansion]
"""From the counts `[owners]` to the expansion."""


def expand_on_device(count: Int[Array, " owners"], *, capacity: int) -> Expansion:
    """Expand into `capacity` entries; `total` is clamped as in `saturated_sum`."""
    owner, rank = expand(count, capacity)
    total = saturated_sum(count)
    return Expansion(owner, rank, jnp.arange(capacity, dtype=jnp.int32) < total, total)


def expand_on_host(count: np.ndarray) -> Expansion:
    """Expand into as many entries as there are, in numpy."""
    start = np.cumsum(count) - count
    owner = np.repeat(np.arange(len(count), dtype=np.int32), count)
    rank = (np.arange(len(owner)) - start[owner]).astype(np.int32)
    return Expansion(owner, rank, np.ones(len(owner), bool), count.sum(dtype=np.int64))


def expand(
    count: Int[Array, " owners"], capacity: int
) -> tuple[Int[Array, " entries"], Int[Array, " entries"]]:
    """Owner and rank of each of `capacity` entries.

    Entries beyond the sum of the counts name the last owner that has any.
    """
    start = cumulative_sum(count) - count
    numbers = jnp.where(count > 0, jnp.arange(count.shape[0], dtype=jnp.int32), 0)
    first_entries = jnp.zeros(capacity, jnp.int32).at[start].max(numbers, mode="drop")
    owner = cumulative_max(first_entries)
    return owner, jnp.arange(capacity, dtype=jnp.int32) - start[owner]


def saturated_sum(counts: Int[Array, " owners"]) -> Int[Array, ""]:
    """The sum, clamped to 2^30: a sum that wrapped around could pass for a small one."""
    fits = jnp.sum(counts.astype(jnp.float32)) < 2.0**30
    return jnp.where(fits, jnp.sum(counts, dtype=jnp.int32), 2**30)
