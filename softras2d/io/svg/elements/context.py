"""Defines the options for reading one document, and the results collected so far.

Both dialects use them: `svg`, which is standard SVG, and `course`, which is the subset of SVG of a
rasterizer course.
"""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from ..canvas.display_list import DisplayList
from ..xml.assets import Assets
from ..xml.document import Attributes, in_one_line
from ..xml.notices import MAX_NAMES

SILENT = frozenset({"title", "desc", "metadata"})
"""Elements that draw nothing in SVG, and are therefore skipped without a warning."""

FALLBACK = "data-fallback"
"""Attribute of the elements that `write_svg` adds for browsers alone.

An example is a gradient below a `colortri`. Both dialects skip these elements and their children
without a warning.
"""


@dataclass
class Context:
    """Options for reading one document, and what has been collected from it so far.

    - `name`: name of the document in errors and warnings.
    - `height`, `width`: size of the canvas in pixels.
    - `transform`: the caller's homogeneous map `[3, 3]` from the root's user units to pixels; None
      to fit the drawing into the canvas as the dialect does.
    - `opacity`: whether opacities and alpha are applied; if not, all that is drawn is opaque.
    - `frame`: whether the course's outline of the drawing is drawn, in dialect `course`.
    - `fit`: text that replaces the root's `preserveAspectRatio`; None to use the root's.
    - `assets`: the image files that may be read.
    - `display`: the shapes that have been drawn so far.
    - `background`: sRGB colour of the scene's background, from the root or from a rect that covers
      the canvas; None for white.
    - `unsupported_elements`: number of elements of each name that are not supported, in dialect
      `course`.
    - `ignored`: number of times that each attribute or function had no effect, in dialect `course`.
    """

    name: str
    height: int
    width: int
    transform: np.ndarray | None
    opacity: bool
    frame: bool
    fit: str | None
    assets: Assets
    display: DisplayList
    background: tuple[float, float, float] | None = None
    unsupported_elements: Counter[str] = field(default_factory=Counter)
    ignored: Counter[str] = field(default_factory=Counter)

    def declare_texture(self, attributes: Attributes) -> None:
        """Remember the file `filename` of a `texture` element by its `texid`, for later elements.

        `attributes` are those of the element. Raises `ValueError` for a file that does not exist or
        may not be read.
        """
        self.assets.declare(attributes.get("texid", ""), attributes.get("filename", ""))

    def warning(self) -> str | None:
        """One line that names the faults in a document of dialect `course`, with counts.

        Faults are what was not drawn, had no effect, or was drawn approximately. Returns None if
        there is nothing to name.
        """
        causes = []
        if self.unsupported_elements:
            causes.append(f"not drawn: {_counts(self.unsupported_elements)}")
        if self.ignored:
            causes.append(f"without effect: {_counts(self.ignored)}")
        if count := self.display.approximated:
            causes.append(
                f"self-crossing polygons too large to be clipped, filled nonzero: {count}"
            )
        return in_one_line(f"{self.name}: {'; '.join(causes)}.") if causes else None


def _counts(counter: Counter[str]) -> str:
    """The names in a counter with their counts as text, sorted by name.

    After the first `MAX_NAMES` names, the text says how many more there are.
    """
    names = [f"{name[:60]} ({count})" for name, count in sorted(counter.items())]
    if len(names) > MAX_NAMES:
        names[MAX_NAMES:] = [f"{len(names) - MAX_NAMES} more"]
    return ", ".join(names)
