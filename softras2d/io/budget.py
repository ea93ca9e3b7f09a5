"""How much work one drawing may ask for, counted before the work is done.

A few bytes of a drawing can ask for any amount of work: a polygon that crosses itself everywhere, a
round join of a huge radius, a picture of 16384 x 16384 pixels. Each reading of a document has one
`Budget`. Whoever is about to do work charges it first, so that a file beyond a limit costs little
more than reading its bytes. Below the limits, time grows with the size of the file, at most by a
factor of its logarithm. The limits are far above what drawings need, and low enough that a reading
stays near a gigabyte.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

MAX_ATTRIBUTES = 2**24
"""Attributes of all elements together, those that a DTD adds included. The largest document, of
64 MB, cannot spell out as many."""

MAX_DEFAULTS = 256
"""Attribute defaults that a DTD may declare. Each is added to every element of its name."""

MAX_POINTS = 2**22
"""Points of all polygons, polylines, lines and outlines together."""

MAX_TRIANGLES = 2**21
"""Triangles of the scene, pieces of strokes included."""

MAX_PAIRS = 2**24
"""Pairs of edges of a polygon whose bounding boxes overlap, in all polygons together. Each has to
be looked at to find what crosses. Pairs of pieces of a translucent stroke, which take longer, count
twice."""

MAX_CROSSINGS = 100_000
"""Points in which polygons cross themselves. The faces between them grow alike."""

MAX_EAR_TESTS = 2**27
"""Vertices that are tested against a corner when ears are clipped."""

MAX_STEPS = 2**26
"""Pixels of the course's lines, near the canvas, and of its images, on it."""

MAX_TEXELS = 2**26
"""Pixels of all pictures of a document together; as RGBA in float32 they take 1 GiB."""


class _Limit(NamedTuple):
    """The most that may be charged, and what it counts, for errors."""

    most: int
    noun: str


_LIMITS = {
    "attributes": _Limit(MAX_ATTRIBUTES, "attributes"),
    "points": _Limit(MAX_POINTS, "points"),
    "triangles": _Limit(MAX_TRIANGLES, "triangles"),
    "pairs": _Limit(MAX_PAIRS, "pairs of edges that may cross"),
    "crossings": _Limit(MAX_CROSSINGS, "points in which polygons cross themselves"),
    "ear_tests": _Limit(MAX_EAR_TESTS, "tests of vertices in self-crossing polygons"),
    "steps": _Limit(MAX_STEPS, "pixels of lines and images"),
    "texels": _Limit(MAX_TEXELS, "pixels of pictures"),
}


class BudgetError(ValueError):
    """A drawing that asks for more work than a limit allows.

    `index` is the first shape, among those charged together, that went beyond it.
    """

    def __init__(self, message: str, index: int = 0):
        super().__init__(message)
        self.index = index


class Budget:
    """What one drawing has been charged so far, by kind of work."""

    def __init__(self):
        self._spent = dict.fromkeys(_LIMITS, 0)

    def charge(self, kind: str, count: int, index: int = 0) -> None:
        """Charge work that is about to be done for shape `index`; `BudgetError` if it is too much.

        `kind` is one of the limits above, in lower case and without `MAX`.
        """
        self._spent[kind] += int(count)
        most, noun = _LIMITS[kind]
        if self._spent[kind] > most:
            message = (
                f"brings the drawing to {self._spent[kind]:,} {noun}; at most {most:,} are read."
            )
            raise BudgetError(message, index)

    def charge_each(
        self,
        kind: str,
        counts: Int[np.ndarray, " shapes"],
        indices: Sequence[int] | None = None,
    ) -> None:
        """Charge one count per shape, so that an error tells which went beyond the limit.

        `indices` names the shapes; by default they are numbered from 0.
        """
        # In float64: counts of hostile files may overflow integers, and only their size matters.
        total = np.cumsum(counts, dtype=np.float64) + self._spent[kind]
        beyond = int(np.searchsorted(total, _LIMITS[kind].most, side="right"))
        if beyond < len(counts):
            named = beyond if indices is None else int(indices[beyond])
            self.charge(kind, int(total[beyond]) - self._spent[kind], named)
        self.charge(kind, int(np.sum(counts)))
