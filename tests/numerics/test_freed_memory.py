"""Memory that is freed is kept, so that the next large array finds its pages cleared."""

import subprocess
import sys

import pytest

_PROGRAM = """
import resource, sys
import numpy as np
from softras2d.numerics.freed_memory import keep_freed_memory

kept = keep_freed_memory() if sys.argv[1] == "keep" else False
for _ in range(3):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    np.ones(12_000_000)
    faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before
print(kept, faults * resource.getpagesize() / 2**20)
"""


def _freed_and_cleared(word: str, **environment: str) -> tuple[bool, float]:
    """Whether freed memory is kept, and the MiB that are cleared for an array of 92 MiB.

    Large pages are cleared at once, but count as one fault.
    """
    result = subprocess.run(
        [sys.executable, "-c", _PROGRAM, word],
        env={"PATH": "/usr/bin", "NUMPY_MADVISE_HUGEPAGE": "0"} | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    kept, cleared = result.stdout.split()
    return kept == "True", float(cleared)


@pytest.mark.skipif(sys.platform != "linux", reason="the C library is glibc on Linux only")
def test_freed_memory_is_not_cleared_again():
    is_kept, cleared = _freed_and_cleared("keep")
    if not is_kept:
        pytest.skip("the C library has no mallopt")
    assert cleared < 5 < 80 < _freed_and_cleared("return")[1]


def test_an_environment_that_sets_up_the_allocator_is_respected():
    assert not _freed_and_cleared("keep", MALLOC_ARENA_MAX="2")[0]
