"""Rewrites errors of `fit`, which name its arguments, in the words of the command line."""

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
    """Raise each `ValueError` of the body again, with options in place of arguments.

    `values`: what the user gave for some arguments, such as a file; it follows the option. That of
    `target` stands alone.
    """
    try:
        yield
    except ValueError as error:
        raise ValueError(in_options(str(error), values)) from error


def in_options(message: str, values: Mapping[str, object]) -> str:
    """The message with each argument of `fit` in backticks replaced by its option and its value."""

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
