"""Reads the fields of a message from a page into a dataclass, whatever the message contains."""

import math
from collections.abc import Mapping
from dataclasses import MISSING, fields
from typing import Any, TypeVar

from ..names import check_name

T = TypeVar("T")


def read_fields(kind: type[T], message: Any) -> T:
    """Make a dataclass of type `kind` from a message, an object that was decoded from JSON.

    Each field of the dataclass must be annotated as `int`, `float` or a `Literal` of strings. A
    whole number is accepted for `int` and `float`, even if it was sent as 5.0. A field that the
    message lacks gets its default.

    Raises `ValueError`, with a message of one line, for a message that is not an object. It is also
    raised, naming the field, for a missing field without default, for an unknown field, and for a
    value that has the wrong type, is NaN or is infinite. The dataclass itself may refuse further
    values.
    """
    if not isinstance(message, Mapping):
        raise ValueError(f"{kind.__name__} must be an object; got {type(message).__name__}.")
    known = {field.name: field for field in fields(kind)}  # pyright: ignore
    for name in message:
        if name not in known:
            raise ValueError(f"{kind.__name__} has no field {str(name)[:40]!r}.")
    for name, field in known.items():
        if name not in message and field.default is field.default_factory is MISSING:
            raise ValueError(f"{kind.__name__} needs the field {name!r}.")
    return kind(
        **{name: read_value(name, known[name].type, value) for name, value in message.items()}
    )


def read_value(name: str, expected: Any, value: Any) -> Any:
    """Check `value`; returns it as an `int`, a `float`, or one of the strings of a `Literal`.

    `expected` is `int`, `float` or the `Literal`. Raises `ValueError`, whose message names the
    field `name`, for any other value: of another type, not finite, or not whole for `int`.
    """
    if expected in (int, float):
        if not _is_finite(value) or (expected is int and value != int(value)):
            wanted = "a whole number" if expected is int else "a finite number"
            raise ValueError(f"`{name}` must be {wanted}; got {str(value)[:40]!r}.")
        return expected(value)
    if not isinstance(value, str):
        raise ValueError(f"`{name}` must be a string; got {str(value)[:40]!r}.")
    check_name(name, value[:40], expected)
    return value


def _is_finite(value: Any) -> bool:
    """Whether a value is a finite number within the range of floats."""
    # In Python, true and false are integers.
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def check_range(name: str, value: int | float, least: int | float, most: int | float) -> None:
    """Raise `ValueError`, which names the field `name`, unless `least` <= `value` <= `most`."""
    if not least <= value <= most:
        raise ValueError(f"`{name}` must be {least:g} to {most:g}; got {value:g}.")
