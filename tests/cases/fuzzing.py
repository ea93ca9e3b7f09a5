"""Time limit, seeds and damaged files for the fuzz tests."""

import os
import time
from collections.abc import Iterator

import numpy as np

SECONDS = float(os.environ.get("SOFTRAS2D_FUZZ_SECONDS", "20"))
"""How long the tests of each module run, in seconds, by `SOFTRAS2D_FUZZ_SECONDS`."""

SEED = int(os.environ.get("SOFTRAS2D_FUZZ_SEED", "0"))
"""Number of the first case. To repeat a failure, set `SOFTRAS2D_FUZZ_SEED` to the case it names."""


def cases(share: float = 1.0) -> Iterator[tuple[int, np.random.Generator]]:
    """Yield numbered cases, each with its random generator, for a share of `SECONDS`."""
    end = time.monotonic() + share * SECONDS
    number = SEED
    while number == SEED or time.monotonic() < end:
        yield number, np.random.default_rng(number)
        number += 1


def damaged(data: bytes, rng: np.random.Generator, *, first: int = 0) -> bytes:
    """Damage `data`: replace up to eight bytes, cut off the end, or repeat a piece.

    `first`: bytes before this index are not replaced.
    """
    changed = bytearray(data)
    kind = rng.integers(4)
    if kind == 0:
        return bytes(changed[: rng.integers(len(changed) + 1)])
    if kind == 1:
        at, end = np.sort(rng.integers(first, len(changed) + 1, 2))
        return bytes(changed[:end] + changed[at:end] + changed[end:])
    for at in rng.integers(first, len(changed), rng.integers(1, 9)):
        changed[at] = (0, 1, 0x7F, 0x80, 0xFF, int(rng.integers(256)))[rng.integers(6)]
    return bytes(changed)
