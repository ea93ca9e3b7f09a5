"""How long a fuzz test goes on, and the case that it is at."""

import os
import time
from collections.abc import Iterator

import numpy as np

SECONDS = float(os.environ.get("SOFTRAS2D_FUZZ_SECONDS", "20"))
"""Of each module; more by the environment variable `SOFTRAS2D_FUZZ_SECONDS`."""

SEED = int(os.environ.get("SOFTRAS2D_FUZZ_SEED", "0"))
"""Of the first case; a failure names the case, `SOFTRAS2D_FUZZ_SEED` begins with it."""


def cases(share: float = 1.0) -> Iterator[tuple[int, np.random.Generator]]:
    """Numbers of cases and their random generators, for that share of the module's time."""
    end = time.monotonic() + share * SECONDS
    number = SEED
    while number == SEED or time.monotonic() < end:
        yield number, np.random.default_rng(number)
        number += 1


def flipped(data: bytes, rng: np.random.Generator, *, first: int = 0) -> bytes:
    """Up to eight bytes from `first` on replaced, or the end cut off, or a piece doubled."""
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
