"""Resolves lengths that depend on the viewport or on the font."""

import math
from typing import NamedTuple

from .numbers import is_number, length

MEDIUM = 16.0
"""Font size `medium`, in px, which browsers use unless told otherwise."""


class Viewport(NamedTuple):
    """Sizes to which the lengths of an element are relative.

    - `width`, `height`: of the nearest viewport, in user units, for percentages.
    - `page_width`, `page_height`: of the document, in px, for `vw` and `vh`.
    - `root_font_size`: in px, for `rem`.
    """

    width: float
    height: float
    page_width: float
    page_height: float
    root_font_size: float = MEDIUM

    @property
    def diagonal(self) -> float:
        """100 % of a length that is neither horizontal nor vertical (SVG 2, section 8.9)."""
        return math.hypot(self.width, self.height) / math.sqrt(2.0)

    def length(self, text: str, full: float, font_size: float) -> float:
        """Parse a length in user units, of which 100 % are `full`.

        Raises `ValueError` for any other text. Without a font, `ex` and `ch` are half of the font
        size, as *CSS Values 4*, "Font-relative lengths", says, and `cap` and `ic` are the whole.
        """
        return length(text, full, self._relative_units(font_size))

    def css_length(self, text: str, full: float, font_size: float) -> float:
        """Parse a length of a style sheet like `length`. There, only 0 may lack its unit."""
        value = self.length(text, full, font_size)
        if value and is_number(text):
            raise ValueError(f"the length {text.strip()[:24]!r} has no unit, such as `px`")
        return value

    def _relative_units(self, font_size: float) -> dict[str, float]:
        width, height = self.page_width / 100, self.page_height / 100
        root = self.root_font_size
        return {
            "em": font_size, "ex": font_size / 2, "ch": font_size / 2, "cap": font_size,
            "ic": font_size, "lh": 1.2 * font_size, "rem": root, "rex": root / 2, "rch": root / 2,
            "rcap": root, "ric": root, "rlh": 1.2 * root, "vw": width, "vh": height, "vi": width,
            "vb": height, "vmin": min(width, height), "vmax": max(width, height),
        }  # fmt: skip
