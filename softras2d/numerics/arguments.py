"""Checks the types and ranges of arguments.

This module does not load JAX, so that the command line can check its arguments first.
"""

import operator
from typing import Any


def checked_integer(name: str, value: Any, minimum: int, maximum: int | None = None) -> int:
    """Return an argument as a Python integer; raise `ValueError` unless it is an integer in range.

    Integers of NumPy and JAX are accepted too. Booleans, floats (even whole ones) and traced
    integers, whose values are unknown, are refused.

    - `name`: the argument's name, for the message.
    - `value`: the argument as the caller gave it.
    - `minimum`, `maximum`: the range, both included; no upper end if `maximum` is None.
    """
    try:
        number = None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        number = None
    if number is None or number < minimum or (maximum is not None and number > maximum):
        accepted = f"of {minimum} or more" if maximum is None else f"in {minimum}..{maximum}"
        raise ValueError(f"`{name}` must be an integer {accepted}; got {value!r:.60}.")
    return number


def check_type(name: str, value: Any, expected: type, made_by: str = "") -> None:
    """Raise `ValueError` unless `value` is an instance of `expected`; the message names both types.

    - `name`: the argument's name, for the message.
    - `made_by`: text of the call that returns such an object, for the message.
    """
    if not isinstance(value, expected):
        hint = f", made by {made_by}" if made_by else ""
        raise ValueError(
            f"`{name}` must be a {expected.__name__}{hint}; got {type(value).__name__}."
        )
