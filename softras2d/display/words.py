"""Formats counts and numbers for short descriptions."""

from typing import Any


def count_text(count: Any, noun: str, plural: str | None = None) -> str:
    """Text of a count and its noun, such as `1 triangle` or `1,200 triangles`.

    A count that is no `int`, such as the symbol of a size, is written as `str` gives it, without
    commas. `plural`: the plural of the noun; None: the noun with an s.
    """
    # In a program that is exported for all sizes, a size is a symbol, which has no number format.
    number = f"{count:,}" if isinstance(count, int) else str(count)
    return f"{number} {noun if number == '1' else plural or noun + 's'}"


def number_text(value: Any, digits: int) -> str:
    """Text of a number with `digits` decimals; for anything else, the name of its type."""
    try:
        return f"{value:.{digits}f}"
    except Exception:
        return type(value).__name__
