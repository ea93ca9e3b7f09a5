"""Formats numbers with few decimals, relative paths and short colours, for small SVG files.

Coordinates are integers in units of 10^-digits pixels, where `digits` is their number of decimals.
"""

import numpy as np
from jaxtyping import Float, Int

MAX_DIGITS = 6
"""Maximum number of decimals of a coordinate."""


def to_units(positions: Float[np.ndarray, "*shape"], digits: int) -> Int[np.ndarray, "*shape"]:
    """Round coordinates in pixels to whole units of 10^-digits pixels."""
    return np.rint(positions.astype(np.float64) * 10.0**digits).astype(np.int64)


def unit_text(units: int, digits: int) -> str:
    """The text of `units` * 10^-digits without needless zeros: `-.25` for -25 and 2 digits."""
    sign, all_digits = "-" if units < 0 else "", str(abs(units)).rjust(digits + 1, "0")
    point = len(all_digits) - digits
    integer, fraction = all_digits[:point], all_digits[point:].rstrip("0")
    # `.25` and not `0.25`: SVG allows it, and it is shorter.
    text = integer if not fraction else f"{integer.lstrip('0')}.{fraction}"
    return sign + text


def join_numbers(numbers: list[str]) -> str:
    """Join the texts of numbers to one text for path data, with a blank between two numbers.

    There is no blank before a negative number, since its sign separates it.
    """
    return "".join(
        text if index == 0 or text[0] == "-" else f" {text}" for index, text in enumerate(numbers)
    )


def triangle_path(corners: Int[np.ndarray, "3 2"], digits: int) -> str:
    """Path data of a closed triangle, whose corners are in units of 10^-digits pixels.

    The data is in pixels, like `M1 .5l2 0 0 3z`. The first corner is absolute; each other one is
    relative to the one before.
    """
    offsets = np.diff(corners, axis=0).ravel().tolist()
    first_corner = join_numbers([unit_text(units, digits) for units in corners[0].tolist()])
    return f"M{first_corner}l{join_numbers([unit_text(units, digits) for units in offsets])}z"


def short_color(color: Float[np.ndarray, "3"]) -> str:
    """An RGB colour, clipped to 0..1 and rounded to 8 bits, as CSS.

    The text is `#rgb` if both hex digits of every channel are equal, else `#rrggbb`.
    """
    text = "".join(f"{level:02x}" for level in np.rint(np.clip(color, 0, 1) * 255).astype(int))
    return f"#{text[::2]}" if text[::2] == text[1::2] else f"#{text}"
