"""Parses font sizes, in the property `font-size` and in the shorthand `font`."""

import contextlib

from ..values.numbers import is_number
from ..values.units import MEDIUM, Viewport

_KEYWORDS = {
    # CSS Fonts 4, absolute sizes of `font-size`.
    name: MEDIUM * factor
    for name, factor in zip(
        ("xx-small", "x-small", "small", "medium", "large", "x-large", "xx-large", "xxx-large"),
        (3 / 5, 3 / 4, 8 / 9, 1, 6 / 5, 3 / 2, 2, 3),
        strict=True,
    )
}

_INHERITED = ("inherit", "unset", "revert", "revert-layer")
"""Values of `font` that keep the parent's font size."""

_FONTS_WITHOUT_SIZE = (
    "inherit", "unset", "initial", "revert", "revert-layer", "caption", "icon", "menu",
    "message-box", "small-caption", "status-bar",
)  # fmt: skip
"""Values of `font` that name no size.

System fonts, such as `caption`, have about the size `medium`.
"""


def font_size_of(text: str, parent_size: float, viewport: Viewport) -> float:
    """Parse a font size; returns it in user units.

    - `text`: a keyword, length or percentage, without blanks around it. A number without a unit is
      in user units.
    - `parent_size`: font size of the parent in user units, for `%`, `larger`, `smaller`, and units
      such as `em`.
    - `viewport`: sizes to which units such as `vw` and `rem` are relative.

    Raises `ValueError` for any other text, and for a negative size.
    """
    if text.lower() in _KEYWORDS:
        return _KEYWORDS[text.lower()]
    if text.lower() in ("larger", "smaller"):
        return parent_size * (1.2 if text.lower() == "larger" else 1 / 1.2)
    size = viewport.length(text, parent_size, parent_size)
    if size < 0:
        raise ValueError("must not be negative")
    return size


def shorthand_size(text: str, parent_size: float, viewport: Viewport) -> float | None:
    """The font size, in user units, that a value of the shorthand `font` gives.

    `parent_size` and `viewport` are as for `font_size_of`. The size is the first word of `text`
    that is a font size. If the word has a `/`, what follows it is the line height, and is ignored.
    Numbers other than `0` are skipped: they are weights, as sizes have units in CSS. The keywords
    of `_INHERITED` give `parent_size`, and the others of `_FONTS_WITHOUT_SIZE` give `MEDIUM`.
    Returns None if the first 16 words have no size, which makes the value invalid.
    """
    keyword = text.strip().lower()
    if keyword in _FONTS_WITHOUT_SIZE:
        return parent_size if keyword in _INHERITED else MEDIUM
    for word in text.split()[:16]:
        word = word.partition("/")[0]
        if is_number(word) and word != "0":
            continue
        with contextlib.suppress(ValueError):
            return font_size_of(word, parent_size, viewport)
    return None
