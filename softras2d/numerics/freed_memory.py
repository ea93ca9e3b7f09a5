"""Keeps freed memory in the process, so that the system need not clear it for the next large array.

Every call of a compiled program allocates its temporary arrays, and frees them at its end. The C
library of Linux returns large arrays to the system at once, in threads other than the main one even
those of some mebibytes. The system then clears the pages of the next array one by one. In such a
thread, `keep_freed_memory` shortens the drawing of flat pictures of 1600 x 1216 pixels by 14 to
34 % (glibc 2.36, JAX 0.10.2).
"""

import ctypes
import os
import sys

_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3
"""Parameters of `mallopt`, as in glibc's `malloc.h`."""

_LARGEST = 2**31 - 1
"""The largest value that `mallopt` takes, in bytes."""

_LARGEST_BEFORE_2_35 = 2**25
"""The largest `_MMAP_THRESHOLD` that glibc accepted before version 2.35, in bytes."""


def keep_freed_memory() -> bool:
    """Let the C library keep freed memory, up to 2 GiB in each heap; return whether it will.

    This changes the whole process, so a library should not do it unasked: it is for programs that
    draw again and again. The main thread has a heap of its own. The heaps of other threads cannot
    hold arrays of more than some 60 MiB, so the setting has no effect on such arrays in those
    threads. Before glibc 2.35 it has no effect on arrays of 32 MiB or more. Nothing is changed on
    systems other than Linux with glibc, nor if the environment sets up the allocator
    (`MALLOC_...`, `GLIBC_TUNABLES`).
    """
    is_set_up = any(name.startswith(("MALLOC_", "GLIBC_TUNABLES")) for name in os.environ)
    if sys.platform != "linux" or is_set_up:
        return False
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return False
    # First, because glibc no longer adapts this threshold once any of the three is set.
    if not any(mallopt(_MMAP_THRESHOLD, size) for size in (_LARGEST, _LARGEST_BEFORE_2_35)):
        return False
    return bool(mallopt(_TRIM_THRESHOLD, _LARGEST) and mallopt(_TOP_PAD, 2**26))
