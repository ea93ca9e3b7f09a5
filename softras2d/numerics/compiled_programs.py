"""Drops compiled programs before there are too many for one process.

Each compiled program holds memory maps, a few hundred for a render, and Linux allows a process some
65,000 maps. The compiler crashes when they run out.
"""

from pathlib import Path

import jax

_MAPS = Path("/proc/self/maps")
_LIMIT = Path("/proc/sys/vm/max_map_count")

_SHARE = 0.3
"""Fraction of the allowed memory maps above which programs are dropped. It is low, because one step
of a loop may compile many programs."""


def drop_programs(max_maps: int | None = None) -> bool:
    """Drop all compiled programs of JAX if the process has more than `max_maps` memory maps.

    By default, `max_maps` is 0.3 times (`_SHARE`) the number of maps that Linux allows a process.
    Returns whether programs were dropped. Call it in loops that compile again and again, between
    two steps and outside any trace. Programs that are needed later are compiled again. On other
    systems than Linux it does nothing and returns false.
    """
    try:
        limit = int(_LIMIT.read_text())
        maps = _MAPS.read_bytes().count(b"\n")
    except (OSError, ValueError):
        return False
    if maps <= (_SHARE * limit if max_maps is None else max_maps):
        return False
    jax.clear_caches()
    return True
