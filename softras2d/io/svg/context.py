"""What the readers of both dialects share while they read one document."""

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from .assets import Assets
from .display_list import DisplayList
from .document import Attributes, in_one_line

SILENT = frozenset({"title", "desc", "metadata"})
"""Elements that draw nothing in any SVG, so that nothing is missed without them."""

FALLBACK = "data-fallback"
"""Attribute of elements that `write_svg` adds for browsers alone, such as a gradient below a
`colortri`. Both dialects skip them, with all that they hold, and without a warning."""


@dataclass
class Context:
    """One reading: where it goes, what it may open, and what it could not draw.

    - `height`, `width`: of the canvas in pixels.
    - `transform`: the caller's map from svg to pixels, or None for the dialect's own view.
    - `opacity`: whether opacities and alpha are honoured.
    - `frame`: whether the course's outline of the canvas is drawn.
    """

    name: str
    height: int
    width: int
    transform: np.ndarray | None
    opacity: bool
    frame: bool
    assets: Assets
    display: DisplayList
    background: tuple[float, float, float] | None = None
    elements: Counter[str] = field(default_factory=Counter)
    ignored: Counter[str] = field(default_factory=Counter)

    def declare_texture(self, attributes: Attributes) -> None:
        """Let the `texid` of a `texture` element name its file, for elements after it."""
        self.assets.declare(attributes.get("texid", ""), attributes.get("filename", ""))

    def warning(self) -> str | None:
        """One line that names all that was left out, with counts."""
        parts = []
        if self.elements:
            parts.append(f"not drawn: {_counts(self.elements)}")
        if self.ignored:
            parts.append(f"without effect: {_counts(self.ignored)}")
        if count := self.display.approximated:
            parts.append(f"self-crossing polygons too large to be clipped, filled nonzero: {count}")
        return in_one_line(f"{self.name}: {'; '.join(parts)}.") if parts else None


_MOST_NAMES = 50
"""Names in a warning. A hostile file may have as many as it has elements."""


def _counts(counter: Counter[str]) -> str:
    names = [f"{name[:60]} ({count})" for name, count in sorted(counter.items())]
    more = [f"{len(names) - _MOST_NAMES} more"] if len(names) > _MOST_NAMES else []
    return ", ".join(names[:_MOST_NAMES] + more)
