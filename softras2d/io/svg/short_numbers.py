"""Numbers with few decimals, and paths with relative coordinates, for small SVG files."""

import numpy as np
from jaxtyping import Float, Int

MAX_DIGITS = 6
"""Most decimals of a coordinate."""


def to_units(positions: Float[np.ndarray, "*shape"], digits: int) -> Int[np.ndarray, "*shape"]:
    """Round coordinates to whole units of 10^-digits pixels."""
    return np.rint(positions.astype(np.float64) * 10.0**digits).astype(np.int64)


def unit_text(units: int, digits: int) -> str:
    """The shortest decimal of a number of units, such as `-.25`."""
    sign, whole = "-" if units < 0 else "", str(abs(units)).rjust(digits + 1, "0")
    integer, decimals = whole[: len(whole) - digits], whole[len(whole) - digits :].rstrip("0")
    text = integer if not decimals else f"{integer.lstrip('0')}.{decimals}"
    return sign + text


def joined(numbers: list[str]) -> str:
    """Numbers in a row, with a blank only where the next one does not begin with a sign."""
    return "".join(
        text if index == 0 or text[0] == "-" else f" {text}" for index, text in enumerate(numbers)
    )


def triangle_path(corners: Int[np.ndarray, "3 2"], digits: int) -> str:
    """A closed triangle as path data: one absolute corner, and two relative ones."""
    steps = np.diff(corners, axis=0).ravel().tolist()
    first = joined([unit_text(units, digits) for units in corners[0].tolist()])
    return f"M{first}l{joined([unit_text(units, digits) for units in steps])}z"


def short_color(color: Float[np.ndarray, "3"]) -> str:
    """A colour in 0..1 as `#rrggbb`, or as `#rgb` if that is the same."""
    text = "".join(f"{level:02x}" for level in np.rint(np.clip(color, 0, 1) * 255).astype(int))
    return f"#{text[::2]}" if text[::2] == text[1::2] else f"#{text}"
