"""Parses numbers in attributes: lists, lengths with units, fractions, and the course's numbers.

Functions for standard SVG are strict: text that its grammar does not allow is an error.
The *course* is a rasterizer course whose subset of SVG is the dialect `"course"`. Functions for the
course stop reading at the first text that does not fit, without an error, as its program does. Only
NaN and infinity, and for `leading_float` a text without a number, are errors.
"""

import math
import re
from collections.abc import Mapping

import numpy as np

# Every quantifier is possessive (`++`, `*+`, `?+`), that is, it never backtracks, so that matching
# takes linear time. Ordinary quantifiers try all ways to split a run of digits or blanks.
NUMBER = r"[+-]?+(?:[0-9]++(?:\.[0-9]*+)?+|\.[0-9]++)(?:[eE][+-]?+[0-9]++)?+"
"""Regular expression that matches a number in SVG, without groups."""

_NUMBER = re.compile(NUMBER)
_NEXT = re.compile(rf"\s*+(,?+)\s*+({NUMBER})")
_LEADING = re.compile(rf"\s*+({NUMBER})")
_LENGTH = re.compile(rf"\s*+({NUMBER})\s*+([a-zA-Z]++|%?+)\s*+\Z")
# A number, one separator (a blank, or another character with blanks before it), and a number.
_PAIR = re.compile(rf"\s*+({NUMBER})(?:\s*+[^\s0-9.+-]|\s)\s*+({NUMBER})")
_NOT_FINITE = re.compile(r"(?<![a-z])[+-]?+(nan|inf(inity)?+)(?![a-z])", re.IGNORECASE)
_DOUBLE_COMMA = re.compile(r",\s*+,")

FLOAT32_MAX = float(np.finfo(np.float32).max)

_PIXELS_PER_UNIT = {
    # CSS Values 4, "Absolute lengths": an inch is 96 px.
    "": 1.0, "px": 1.0, "in": 96.0, "cm": 96 / 2.54, "mm": 96 / 25.4, "q": 96 / 101.6,
    "pt": 96 / 72, "pc": 16.0,
}  # fmt: skip


def number_list(text: str) -> list[float]:
    """Parse a list of numbers, by the grammar of SVG; empty text gives an empty list.

    Numbers are separated by blanks, by a comma, or by nothing if the next one begins with a sign or
    a point. Raises `ValueError` for any other text, and for numbers that are not finite.
    """
    if text.isascii() and "_" not in text:
        # `split` and `float` are much faster than the regular expression, and sufficient for the
        # common spelling. They accept misplaced commas, which the checks below find.
        try:
            values = [float(word) for word in text.replace(",", " ").split()]
        except ValueError:
            pass
        else:
            has_commas = "," in text
            tidy = not has_commas or not (_DOUBLE_COMMA.search(text) or text.strip()[0] == ",")
            if math.isfinite(sum(values)) and tidy and text.rstrip()[-1:] != ",":
                return values
    values, position = [], 0
    text = text.rstrip()
    while position < len(text):
        match = _NEXT.match(text, position)
        if match is None or (match[1] and not values):
            raise ValueError(f"expected a number, got {_excerpt(text[position:])}.")
        values.append(finite(match[2]))
        position = match.end()
    return values


def leading_numbers(text: str) -> tuple[list[float], str | None]:
    """Parse a list of numbers, by the grammar of SVG, up to the first error.

    Returns the numbers before the error, and the message of the error; None if there is no error.
    """
    try:
        return number_list(text), None
    except ValueError as error:
        values, position = [], 0
        while match := _NEXT.match(text, position):
            if match[1] and not values:
                break
            value = float(match[2])
            if not math.isfinite(value):
                break
            values.append(value)
            position = match.end()
        return values, str(error)


def number_pairs(text: str) -> list[float]:
    """Parse a list of points as the course does; returns x and y alternately, rounded to float32.

    A point is a number, a separator and a number. The separator is blanks, or one other character,
    with or without blanks around it, that is no digit, sign or point. Reading stops at text that is
    no point. Raises `ValueError` for numbers that are not finite in float32, and if NaN or infinity
    is written anywhere after the last point.
    """
    values, position = [], 0
    while match := _PAIR.match(text, position):
        values += [finite32(match[1]), finite32(match[2])]
        position = match.end()
    if word := _infinity_or_nan(text[position:]):
        raise ValueError(f"expected a number, got {word}.")
    return values


def blank_separated(text: str) -> list[float]:
    """Parse numbers with blanks between them as the course does; returns them rounded to float32.

    Reading stops at the first word that is no number. If the word begins with a number, such as
    `2px`, this number is the last one of the result. If it does not, and has NaN or infinity in it,
    `ValueError` is raised. `ValueError` is also raised for numbers that are not finite in float32.
    """
    values = []
    for word in text.split():
        match = _LEADING.match(word)
        if match is None:
            if word := _infinity_or_nan(word):
                raise ValueError(f"expected a number, got {word}.")
            break
        values.append(finite32(match[1]))
        if match.end() != len(word):
            break
    return values


def leading_float(text: str | None) -> float:
    """Parse the number with which a text begins, as the course does; returns it rounded to float32.

    A missing attribute, None, is 0. Raises `ValueError` for text that does not begin with a number,
    and for a number that is not finite in float32.
    """
    if text is None:
        return 0.0
    match = _LEADING.match(text)
    if match is None:
        raise ValueError(f"expected a number, got {_excerpt(text)}.")
    return finite32(match[1])


def length(text: str, full: float | None, units: Mapping[str, float] | None = None) -> float:
    """Parse a length in any unit; returns it in px.

    - `full`: length of 100 %, in px; None if percentages are not allowed.
    - `units`: sizes in px of further units, such as `em`, besides the absolute ones; None for no
      others.

    A number without a unit is in px. The result may be negative. Raises `ValueError` for any other
    text, and for a length that is not finite.
    """
    match = _LENGTH.match(text)
    if match is None:
        raise ValueError(f"expected a length, got {_excerpt(text)}.")
    value, unit = finite(match[1]), match[2].lower()
    if unit == "%" and full is not None:
        pixels = value / 100 * full
    elif units is not None and unit in units:
        pixels = value * units[unit]
    elif unit in _PIXELS_PER_UNIT:
        pixels = value * _PIXELS_PER_UNIT[unit]
    else:
        raise ValueError(
            f"lengths in {unit!r} are not supported, got {_excerpt(text)}; "
            "use px, pt, pc, mm, cm or in."
        )
    if not math.isfinite(pixels):
        raise ValueError(f"{_excerpt(text)} is not a finite length.")
    return pixels


def is_number(text: str) -> bool:
    """Whether a text is a single number of SVG without a unit, which blanks may surround.

    The number may be too large for a float, as `1e999`.
    """
    match = _LENGTH.match(text)
    return match is not None and not match[2]


def fraction(text: str) -> float:
    """Parse an opacity or an offset, which is a number or a percentage, and clamp it to 0..1.

    Raises `ValueError` for any other text.
    """
    match = _LENGTH.match(text)
    if match is None or match[2] not in ("", "%"):
        raise ValueError(f"expected a number in 0..1, got {_excerpt(text)}.")
    return min(max(finite(match[1]) / (100 if match[2] else 1), 0.0), 1.0)


def finite(text: str) -> float:
    """Parse a number as float64, by the grammar of SVG and without blanks around it.

    Raises `ValueError` if it is not finite, and for any other text, such as `1_000`, which Python
    would read.
    """
    if not _NUMBER.fullmatch(text) or not math.isfinite(value := float(text)):
        raise ValueError(f"{_excerpt(text)} is not a finite number.")
    return value


def finite32(text: str) -> float:
    """Parse a number, in any spelling that Python reads, and round it to float32.

    Raises `ValueError` if it is not finite in float32, or no number.
    """
    value = float(text)
    if not abs(value) <= FLOAT32_MAX:
        raise ValueError(f"{_excerpt(text)} is not a finite number in float32.")
    return float(np.float32(value))


def _infinity_or_nan(text: str) -> str | None:
    """The first word in a text that means NaN or infinity, quoted for an error message.

    Returns None if there is no such word. If the course's functions stopped at one without an
    error, a fault of the program that wrote the file would remain hidden.
    """
    match = _NOT_FINITE.search(text)
    return _excerpt(match[0]) if match else None


def _excerpt(text: str) -> str:
    """The first 24 characters of a text without blanks around it, in quotes, for error messages.

    Longer texts end in `...`.
    """
    text = text.strip()
    return repr(text if len(text) <= 24 else text[:24] + "...")
