"""Limits the work that one drawing can cause, by counting it before it is done.

A few bytes of a drawing can cause any amount of work: a polygon that crosses itself everywhere, a
round join of a huge radius, an image of 16384 x 16384 pixels. Each time a document is read, one
`Budget` is created. Code that does work first charges the budget for it, so that a file beyond a
limit is refused before most of the work is done. Work that no limit counts takes time about linear
in the size of the file, apart from a logarithmic factor. The limits are far above what ordinary
drawings need.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

MAX_ATTRIBUTES = 2**24
"""Maximum number of attributes of all elements together, with the defaults that a DTD adds.

Without such defaults, a document of 64 MB, the largest that is read, cannot contain as many.
"""

MAX_ELEMENTS = 2**21
"""Maximum number of elements of a document that `read_svg` reads in dialect `"svg"`.

Each element is charged twice, when it is parsed and when it is drawn, so that twice as many charges
are allowed.
"""

MAX_COPIES = 2**17
"""Maximum number of repeated visits to elements: by `use`, by clip paths, for bounding boxes.

A few lines can ask for any number of copies.
"""

MAX_DEFAULTS = 256
"""Maximum number of attribute defaults that a DTD may declare.

A default is added to every element of one name.
"""

MAX_POINTS = 2**22
"""Maximum number of points of all polygons, polylines, lines and outlines of strokes together.

The points of a path count when it is flattened, and again when it is filled or stroked.
"""

MAX_TRIANGLES = 2**21
"""Maximum number of triangles of the scene, and of faces into which contours divide polygons.

For a translucent stroke, its triangles are counted before `strokes.union` unites them.
"""

MAX_PAIRS = 2**24
"""Maximum number of pairs of edges of one polygon whose bounding boxes overlap.

The pairs of all polygons of more than 64 edges are added up. Each pair must be examined to detect
crossings. Pairs of a face and an edge that is examined for the winding number of the face count
too. A pair of triangles of a translucent stroke takes longer and counts twice.
"""

MAX_CROSSINGS = 100_000
"""Maximum number of pairs of edges of one polygon that cross or touch, without a common end.

The pairs of all polygons are added up. The number of faces into which GEOS divides the polygons
grows in proportion to this sum. For polygons of at most 64 edges, the faces beyond their number of
edges are counted instead.
"""

MAX_EAR_TESTS = 2**27
"""Maximum number of tests in ear clipping.

A test asks whether a vertex lies in the triangle of a corner and its two neighbours.
"""

MAX_SELECTOR_TESTS = 2**25
"""Maximum number of tests of style sheets, each of which asks if a selector matches an element.

A selector with descendant combinators counts once for each choice of ancestors that may have to be
tried.
"""

MAX_OVERLAYS = 2**24
"""Maximum work of intersecting, uniting and subtracting regions.

The unit is the work per vertex of an intersection. Clip paths, gradients, and shapes that overlap
in translucent groups need such operations. Each operation counts the vertices that it reads,
several times if it is costly, and a constant.
"""

MAX_STEPS = 2**26
"""Maximum number of pixels of all lines and images, which `read_svg` counts in dialect `"course"`.

Of a long line, only the steps near the canvas count; of an image, only the pixels on the canvas.
"""

MAX_TEXELS = 2**26
"""Maximum number of pixels of all image files of a document together.

As RGBA in float32, so many pixels take 1 GiB.
"""


class _Limit(NamedTuple):
    """A limit on one kind of work. `noun` is the plural of what it counts, used in errors."""

    maximum: int
    noun: str


_LIMITS = {
    "attributes": _Limit(MAX_ATTRIBUTES, "attributes"),
    "elements": _Limit(2 * MAX_ELEMENTS, "elements, each counted twice"),
    "copies": _Limit(MAX_COPIES, "copies of elements"),
    "selector_tests": _Limit(MAX_SELECTOR_TESTS, "tests of style sheets' selectors"),
    "overlays": _Limit(MAX_OVERLAYS, "vertices of regions to clip and cut"),
    "points": _Limit(MAX_POINTS, "points"),
    "triangles": _Limit(MAX_TRIANGLES, "triangles"),
    "pairs": _Limit(MAX_PAIRS, "pairs of edges that may cross"),
    "crossings": _Limit(MAX_CROSSINGS, "points in which polygons cross themselves"),
    "ear_tests": _Limit(MAX_EAR_TESTS, "tests of vertices in self-crossing polygons"),
    "steps": _Limit(MAX_STEPS, "pixels of lines and images"),
    "texels": _Limit(MAX_TEXELS, "pixels of pictures"),
}
"""The limit on each kind of work, by the name that `Budget.charge` takes."""


class BudgetError(ValueError):
    """Raised for a drawing that needs more work than a limit allows, or an image that is too large.

    `index` is the index of the shape whose work exceeds the limit, among the shapes that the caller
    processes together; 0 if the work belongs to no shape. Messages of `Budget.charge` have no
    subject: the caller puts one in front.
    """

    def __init__(self, message: str, index: int = 0):
        super().__init__(message)
        self.index = index


class Budget:
    """Counts the work that one drawing has needed so far, by kind of work, up to a limit for each.

    The kinds are the keys of `_LIMITS`, such as `"triangles"`.
    """

    def __init__(self):
        self._charged = dict.fromkeys(_LIMITS, 0)

    def charge(self, kind: str, count: int, index: int = 0) -> None:
        """Add `count` units of work to the total of `kind`.

        Call it before the work is done, or after each block of work if the size of a block is
        bounded.

        - `kind`: a key of `_LIMITS`, such as `"triangles"`.
        - `index`: index of the shape that needs the work, among the shapes that the caller
          processes together.

        Raises `BudgetError` with this index if the total is then above the limit.
        """
        self._charged[kind] += int(count)
        maximum, noun = _LIMITS[kind]
        if (total := self._charged[kind]) > maximum:
            message = f"brings the drawing to {total:,} {noun}; at most {maximum:,} are read."
            raise BudgetError(message, index)

    def charge_each(
        self,
        kind: str,
        counts: Int[np.ndarray, " shapes"],
        indices: Sequence[int] | None = None,
    ) -> None:
        """Charge the number of units of `kind` that each shape needs.

        - `counts`: number of units for each shape.
        - `indices`: indices of the shapes, for errors; by default they are numbered from 0.

        If the total, with what has been charged before, exceeds the limit, raises `BudgetError`
        with the index of the first shape at which it does.
        """
        # Counts of hostile files may overflow integers. float64 is precise enough to compare them.
        totals = np.cumsum(counts, dtype=np.float64) + self._charged[kind]
        first_beyond = int(np.searchsorted(totals, _LIMITS[kind].maximum, side="right"))
        if first_beyond < len(counts):
            index = first_beyond if indices is None else int(indices[first_beyond])
            self.charge(kind, int(totals[first_beyond]) - self._charged[kind], index)
        self.charge(kind, int(np.sum(counts)))
