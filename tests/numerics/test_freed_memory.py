"""Memory that is freed is kept, so that the next large array finds its pages cleared."""

import platform
import subprocess
import sys

import pytest

_PROGRAM = """
import ctypes, resource, sys
from concurrent.futures import ThreadPoolExecutor
import numpy as np
from softras2d.numerics.freed_memory import keep_freed_memory

# Pages of 4 KiB only: a huge page is cleared in one fault.
ctypes.CDLL(None).prctl(41, 1, 0, 0, 0)
kept = keep_freed_memory() if sys.argv[1] == "keep" else False

def cleared(count):
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
        np.ones(count)
        faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
    return faults * resource.getpagesize() / 2**20

with ThreadPoolExecutor(1) as thread:
    print(kept, cleared(12_000_000), thread.submit(cleared, 6_500_000).result())
"""


def _has_recent_glibc() -> bool:
    library, version = platform.libc_ver()
    return library == "glibc" and tuple(map(int, version.split("."))) >= (2, 35)


_NEEDS_GLIBC = pytest.mark.skipif(not _has_recent_glibc(), reason="needs glibc 2.35 or later")


def _run(word: str, **environment: str) -> tuple[bool, float, float]:
    """Whether freed memory is kept, and the MiB that are cleared for the third of equal arrays.

    The first number is for arrays of 92 MiB in the main thread, the second for arrays of 50 MiB in
    another thread.
    """
    result = subprocess.run(
        [sys.executable, "-c", _PROGRAM, word],
        env={"PATH": "/usr/bin"} | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    kept, *cleared = result.stdout.split()
    return kept == "True", float(cleared[0]), float(cleared[1])


@_NEEDS_GLIBC
def test_freed_memory_is_not_cleared_again():
    is_kept, in_main_thread, in_thread = _run("keep")
    assert is_kept
    assert in_main_thread < 5 and in_thread < 5
    _, in_main_thread, in_thread = _run("return")
    assert in_main_thread > 80 and in_thread > 40


@_NEEDS_GLIBC
def test_an_environment_that_sets_up_the_allocator_is_respected():
    assert not _run("keep", MALLOC_ARENA_MAX="2")[0]
