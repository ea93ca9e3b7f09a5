"""Rewrites errors of `fit`, which name its arguments, so that they name options instead."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

_ARGUMENTS = (
    "triangles", "family", "solver", "seed", "steps", "seconds", "size", "shading", "translucent",
    "softness", "colors", "loss", "light", "weights", "start", "resume", "palette", "freeze",
    "background",
)  # fmt: skip

_OPTIONS = {name: f"--{name}" for name in _ARGUMENTS} | {"triangles": "-n"}
"""The option of the command line for each argument of `fit`."""

_NAMED = re.compile(r"`(\w+)(?:=([^`]*))?`")


@contextmanager
def errors_name_options(values: Mapping[str, object]) -> Iterator[None]:
    """Replace arguments of `fit` by options in the message of a `ValueError` that the body raises.

    `values` are the values that the user gave for some arguments, as in `in_options`.
    """
    try:
        yield
    except ValueError as error:
        raise ValueError(in_options(str(error), values)) from error


def in_options(message: str, values: Mapping[str, object]) -> str:
    """Replace each argument of `fit` in backticks in a message by its option.

    `values` has the values that the user gave for some arguments, such as files; they follow the
    option. In place of `target`, which has no option, its value stands alone. A value inside the
    backticks, as in `loss='ssim'`, follows the option too, unless it is True.
    """

    def option(match: re.Match[str]) -> str:
        name, value = match.groups()
        given = values.get(name)
        if name == "target" and given is not None:
            return str(given)
        if name not in _OPTIONS:
            return match[0]
        if value is not None:
            # `loss='squared'` and `translucent=True` are values to choose.
            return _OPTIONS[name] + ("" if value == "True" else f" {value.strip(chr(39))}")
        return _OPTIONS[name] + ("" if given is None else f" {given}")

    if "target" in values:
        message = message.replace("another `target`", "another picture than `target`")
    return _NAMED.sub(option, message)
