"""Compiled programs dropped before they are too many for one process.

Each keeps memory maps, a few hundred for a render, of which Linux grants a process some 65,000.
Where they run out, the compiler crashes.
"""

from pathlib import Path

import jax

_MAPS = Path("/proc/self/maps")
_LIMIT = Path("/proc/sys/vm/max_map_count")

_SHARE = 0.3
"""Share of the maps granted beyond which programs are dropped: one step of a loop may compile many
more."""


def drop_programs() -> bool:
    """Forget all compiled programs if their memory maps near the limit; whether that was so.

    For loops that compile again and again, between two steps and outside any trace. Programs that
    are needed again are compiled again. Does nothing where the system has no such limit.
    """
    try:
        limit = int(_LIMIT.read_text())
        maps = _MAPS.read_bytes().count(b"\n")
    except (OSError, ValueError):
        return False
    if maps <= _SHARE * limit:
        return False
    jax.clear_caches()
    return True
