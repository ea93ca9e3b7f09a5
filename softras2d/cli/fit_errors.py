"""Rewrites error messages of `fit`, which name its arguments, so that they name options instead."""

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
    """In a `with` block, rewrite the message of a `ValueError`, so that it names options.

    Arguments of `fit` in the message are replaced as by `in_options`, which explains `values`.
    """
    try:
        yield
    except ValueError as error:
        raise ValueError(in_options(str(error), values)) from error


def in_options(message: str, values: Mapping[str, object]) -> str:
    """Replace each argument of `fit` that stands in backticks in a message by its option.

    - `` `loss` `` becomes `--loss`. If `values` has a value for the argument, such as a file, it
      follows the option.
    - A value inside the backticks follows the option, too, unless it is True: `` `loss='ssim'` ``
      becomes `--loss ssim`.
    - `` `target` ``, which has no option, is replaced by its value alone; `` another `target` ``
      becomes `another picture than` and the value.
    - Other names in backticks, and `` `target` `` without a value, are left unchanged.

    `values`: the values that the user gave for some arguments, by name.
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
