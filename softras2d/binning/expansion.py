"""Expand a count per owner into a list with one entry for each counted item.

An owner is whatever the items belong to: a triangle has strips, a strip has tiles, a tile has
chunks. If owner i has `count[i]` items, the list names owner 0 `count[0]` times, then owner 1
`count[1]` times, and so on. Each entry also has a rank, which counts the items of its owner from 0.
For example, the counts (2, 0, 1) give the owners (0, 0, 2) and the ranks (0, 1, 0).

On the device the list has a fixed capacity; on the host it is as long as it needs to be.
`pairs.find_pairs` works with either.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from ..numerics.array_types import HostOrDeviceArray
from ..numerics.prefix import cumulative_max, cumulative_sum


class Expansion(NamedTuple):
    """A list with one entry for each item of every owner, in the order of the owners.

    - `owner`: index of the owner of each entry.
    - `rank`: number of the entry among the entries of its owner, from 0.
    - `is_used`: false for the entries after the first `total`, which only fill the list up to its
      capacity. Their `owner` is a valid index, but there is no such item.
    - `total`: the sum of the counts, clamped to 2^30 on the device. If it exceeds the capacity,
      entries are missing.
    """

    owner: Int[HostOrDeviceArray, " entries"]
    rank: Int[HostOrDeviceArray, " entries"]
    is_used: Bool[HostOrDeviceArray, " entries"]
    total: Int[HostOrDeviceArray, ""]


Expand = Callable[[HostOrDeviceArray], Expansion]
"""A function that expands counts `[owners]` to one entry per item, such as `expand_on_host`."""


def expand_on_device(count: Int[Array, " owners"], *, capacity: int) -> Expansion:
    """Expand counts, in JAX, into a list of `capacity` entries, one for each counted item.

    The list repeats the index of owner i `count[i]` times. Items beyond the capacity are left out,
    but `total` counts them too, clamped to 2^30 (`saturated_sum`). If there are fewer items, the
    last entries are unused.
    """
    owner, rank = expand(count, capacity)
    total = saturated_sum(count)
    return Expansion(owner, rank, jnp.arange(capacity, dtype=jnp.int32) < total, total)


def expand_on_host(count: np.ndarray) -> Expansion:
    """Expand counts, in numpy, into a list that is exactly as long as the sum of the counts.

    The list has one entry for each counted item: it repeats the index of owner i `count[i]` times.
    """
    start = np.cumsum(count) - count
    owner = np.repeat(np.arange(len(count), dtype=np.int32), count)
    rank = (np.arange(len(owner)) - start[owner]).astype(np.int32)
    return Expansion(owner, rank, np.ones(len(owner), bool), count.sum(dtype=np.int64))


def expand(
    count: Int[Array, " owners"], capacity: int
) -> tuple[Int[Array, " entries"], Int[Array, " entries"]]:
    """Compute the owner and the rank of each of `capacity` entries, as defined by `Expansion`.

    Owner i is named by `count[i]` successive entries, whose ranks are 0, 1, and so on. Entries
    beyond the sum of the counts are unused. They name the last owner that has an item, or owner 0
    if no owner has one, and their ranks are not below the count of that owner.
    """
    start = cumulative_sum(count) - count
    numbers = jnp.where(count > 0, jnp.arange(count.shape[0], dtype=jnp.int32), 0)
    first_entries = jnp.zeros(capacity, jnp.int32).at[start].max(numbers, mode="drop")
    owner = cumulative_max(first_entries)
    return owner, jnp.arange(capacity, dtype=jnp.int32) - start[owner]


def saturated_sum(counts: Int[Array, " owners"]) -> Int[Array, ""]:
    """Sum of the counts, or 2^30 if it is about 2^30 or more.

    A float32 sum decides which: an int32 sum that wraps around could pass for a small one.
    """
    fits = jnp.sum(counts.astype(jnp.float32)) < 2.0**30
    return jnp.where(fits, jnp.sum(counts, dtype=jnp.int32), 2**30)
