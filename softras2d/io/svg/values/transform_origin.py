"""Parses the property `transform-origin`."""

from collections.abc import Sequence

from .units import Viewport


def transform_origin(
    text: str, box: Sequence[float], viewport: Viewport, font_size: float
) -> tuple[float, float]:
    """Parse `transform-origin`; returns the origin (x, y) in user units.

    - `text`: one to three values, of which the third, z, is ignored.
    - `box`: the reference box (x, y, width, height) in user units. Keywords, lengths and
      percentages are relative to its top left corner.
    - `viewport`, `font_size`: resolve units such as `vw` and `em`. A number without a unit is in
      user units.

    Raises `ValueError` for text that is no origin.

    **Source:** *CSS Transforms 1*, "The `transform-origin` property".
    """
    words = text.lower().split()
    if not 1 <= len(words) <= 3:
        raise ValueError("transform-origin: expected one to three values.")
    words = words[:2]
    if len(words) == 1:
        words.append("center")
        if words[0] in ("top", "bottom"):
            words.reverse()
    elif words[0] in ("top", "bottom") or words[1] in ("left", "right"):
        words.reverse()
    x, y, width, height = box
    return (
        x + _origin_along(words[0], ("left", "center", "right"), width, viewport, font_size),
        y + _origin_along(words[1], ("top", "center", "bottom"), height, viewport, font_size),
    )


def _origin_along(
    word: str, keywords: Sequence[str], side: float, viewport: Viewport, font_size: float
) -> float:
    """Parse one value of `transform-origin`.

    Returns the distance of the origin from the left or top edge of the box, in user units.

    - `keywords`: words for the start, the middle and the end of the side.
    - `side`: length of the box along this axis, in user units.
    """
    if word in keywords:
        return keywords.index(word) / 2 * side
    return viewport.length(word, side, font_size)
