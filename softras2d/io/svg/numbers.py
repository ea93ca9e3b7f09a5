"""Numbers as SVG writes them: lists, lengths with units, and the course's leading floats."""

import math
import re

import numpy as np

# Every quantifier is possessive (`++`, `*+`, `?+`): it never gives back what it took, so that time
# is linear in the text. Ordinary ones try all ways to split a run of digits or blanks.
_NUMBER = r"[+-]?+(?:[0-9]++(?:\.[0-9]*+)?+|\.[0-9]++)(?:[eE][+-]?+[0-9]++)?+"
_NEXT = re.compile(rf"\s*+(,?+)\s*+({_NUMBER})")
_LEADING = re.compile(rf"\s*+({_NUMBER})")
_LENGTH = re.compile(rf"\s*+({_NUMBER})\s*+([a-zA-Z]++|%?+)\s*+\Z")
# Number, one separating character (blanks before it do not count), number.
_PAIR = re.compile(rf"\s*+({_NUMBER})(?:\s*+[^\s0-9.+-]|\s)\s*+({_NUMBER})")
_NOT_FINITE = re.compile(r"(?<![a-z])[+-]?+(nan|inf(inity)?+)(?![a-z])", re.IGNORECASE)
_DOUBLE_COMMA = re.compile(r",\s*+,")

FLOAT32_MAX = float(np.finfo(np.float32).max)

_PIXELS = {
    # CSS Values 4, section 6.2: 96 px are an inch.
    "": 1.0, "px": 1.0, "in": 96.0, "cm": 96 / 2.54, "mm": 96 / 25.4, "q": 96 / 101.6,
    "pt": 96 / 72, "pc": 16.0,
}  # fmt: skip


def number_list(text: str) -> list[float]:
    """All numbers of a list; blanks, a comma, or nothing where a sign or point begins the next.

    Raises `ValueError` for anything else, and for numbers that are not finite.
    """
    if text.isascii() and "_" not in text:
        # The common spelling, at the speed of C.
        try:
            values = [float(word) for word in text.replace(",", " ").split()]
        except ValueError:
            pass
        else:
            commas = text.count(",")
            tidy = not commas or not (_DOUBLE_COMMA.search(text) or text.strip()[0] == ",")
            if math.isfinite(sum(values)) and tidy and text.rstrip()[-1:] != ",":
                return values
    values, place = [], 0
    text = text.rstrip()
    while place < len(text):
        found = _NEXT.match(text, place)
        if found is None or (found[1] and not values):
            raise ValueError(f"expected a number, got {_excerpt(text[place:])}.")
        values.append(finite(found[2]))
        place = found.end()
    return values


def number_pairs(text: str) -> list[float]:
    """The course's points: number, one separator, number, until something does not fit; float32."""
    values, place = [], 0
    while found := _PAIR.match(text, place):
        values += [finite32(found[1]), finite32(found[2])]
        place = found.end()
    if word := _not_a_number(text[place:]):
        raise ValueError(f"expected a number, got {word}.")
    return values


def blank_separated(text: str) -> list[float]:
    """The course's lists: numbers with blanks between, until something else comes; float32."""
    values = []
    for word in text.split():
        found = _LEADING.match(word)
        if found is None:
            if word := _not_a_number(word):
                raise ValueError(f"expected a number, got {word}.")
            break
        values.append(finite32(found[1]))
        if found.end() != len(word):
            break
    return values


def leading_float(text: str | None) -> float:
    """The course's numbers: what a text begins with, in float32; 0 for a missing attribute."""
    if text is None:
        return 0.0
    found = _LEADING.match(text)
    if found is None:
        raise ValueError(f"expected a number, got {_excerpt(text)}.")
    return finite32(found[1])


def length(text: str, whole: float | None) -> float:
    """A length in px; `whole` is what 100 % are, None where a percentage has no meaning."""
    found = _LENGTH.match(text)
    if found is None:
        raise ValueError(f"expected a length, got {_excerpt(text)}.")
    value, unit = finite(found[1]), found[2].lower()
    if unit == "%" and whole is not None:
        return value / 100 * whole
    if unit not in _PIXELS:
        raise ValueError(
            f"lengths in {unit!r} are not supported, got {_excerpt(text)}; "
            "use px, pt, pc, mm, cm or in."
        )
    return value * _PIXELS[unit]


def fraction(text: str) -> float:
    """An opacity, as a number or a percentage, clamped to 0..1."""
    found = _LENGTH.match(text)
    if found is None or found[2] not in ("", "%"):
        raise ValueError(f"expected a number in 0..1, got {_excerpt(text)}.")
    return min(max(finite(found[1]) / (100 if found[2] else 1), 0.0), 1.0)


def finite(text: str) -> float:
    """The number, or `ValueError` if float64 does not hold it."""
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{_excerpt(text)} is not a finite number.")
    return value


def finite32(text: str) -> float:
    """The number rounded to float32, or `ValueError` if that is infinite."""
    value = float(text)
    if not abs(value) <= FLOAT32_MAX:
        raise ValueError(f"{_excerpt(text)} is not a finite number in float32.")
    return float(np.float32(value))


def _not_a_number(text: str) -> str | None:
    """A word that says NaN or infinity, which no quirk should hide."""
    found = _NOT_FINITE.search(text)
    return _excerpt(found[0]) if found else None


def _excerpt(text: str) -> str:
    text = text.strip()
    return repr(text if len(text) <= 24 else text[:24] + "...")
