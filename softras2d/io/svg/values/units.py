"""Resolves lengths that are relative to the viewport or to the font."""

import math
from typing import NamedTuple

from .numbers import is_number, length

MEDIUM = 16.0
"""Font size `medium`, in px, the usual default of browsers."""


class Viewport(NamedTuple):
    """Sizes to which the lengths of an element are relative.

    - `width`, `height`: size of the nearest viewport, in user units, for percentages.
    - `page_width`, `page_height`: size of the document, in px, for `vw` and `vh`.
    - `root_font_size`: font size of the root, in px, for `rem`.
    """

    width: float
    height: float
    page_width: float
    page_height: float
    root_font_size: float = MEDIUM

    @property
    def diagonal(self) -> float:
        """The length of 100 %, in user units, for lengths that are neither horizontal nor vertical.

        **Source:** SVG 2, section 8.9.
        """
        return math.hypot(self.width, self.height) / math.sqrt(2.0)

    def length(self, text: str, full: float, font_size: float) -> float:
        """Parse the length in an attribute; returns it in user units.

        - `full`: length of 100 %, in user units.
        - `font_size`: font size of the element, in user units, for units such as `em` and `ex`.

        A number without a unit is in user units. No font is loaded: `ex` and `ch` are half of the
        font size, as *CSS Values 4*, "Font-relative lengths", says, `cap` and `ic` are the font
        size, and `lh` is 1.2 times the font size. Raises `ValueError` for text that is no length.
        """
        return length(text, full, self._relative_units(font_size))

    def css_length(self, text: str, full: float, font_size: float) -> float:
        """Parse a length in CSS; returns it in user units.

        The arguments and units are as for `length`. Unlike there, a number without a unit raises
        `ValueError`, unless it is 0.
        """
        value = self.length(text, full, font_size)
        if value and is_number(text):
            raise ValueError(f"the length {text.strip()[:24]!r} has no unit, such as `px`")
        return value

    def _relative_units(self, font_size: float) -> dict[str, float]:
        """Length, in user units, of each unit that is relative to the font or to the page.

        `font_size` is the font size of the element, in user units. Keys are names of units in lower
        case.
        """
        width, height = self.page_width / 100, self.page_height / 100
        root = self.root_font_size
        return {
            "em": font_size, "ex": font_size / 2, "ch": font_size / 2, "cap": font_size,
            "ic": font_size, "lh": 1.2 * font_size, "rem": root, "rex": root / 2, "rch": root / 2,
            "rcap": root, "ric": root, "rlh": 1.2 * root, "vw": width, "vh": height, "vi": width,
            "vb": height, "vmin": min(width, height), "vmax": max(width, height),
        }  # fmt: skip
