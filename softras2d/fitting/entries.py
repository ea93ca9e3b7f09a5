"""Check the type, shape and range of each array of a saved fit before it is used."""

import json
from typing import Any, NamedTuple

import numpy as np

TINY = float(np.finfo(np.float32).tiny)
"""The smallest normal float32, a lower bound for saved numbers that must be positive."""


class Size(NamedTuple):
    """Size of an image in pixels, and its number of channels."""

    height: int
    width: int
    channels: int


class Entries:
    """The arrays of a saved fit, by name, in a copy from which a reader takes each one once.

    `take` checks the type and the shape of the array that it removes, `finite` also its values, and
    `drop` checks nothing. After the reader has taken all arrays that a fit has, `end` refuses those
    that are left. Every fault, also a missing array, raises `ValueError`.

    - `arrays`: the arrays by name; the dictionary is copied, not changed.
    - `prefix`: text before the names in error messages, such as `"state."`.
    """

    def __init__(self, arrays: dict[str, Any], prefix: str = ""):
        self._remaining = dict(arrays)
        self._prefix = prefix

    def __contains__(self, name: str) -> bool:
        return name in self._remaining

    def full_name(self, name: str) -> str:
        """The name of an array with its prefix, for error messages."""
        return f"{self._prefix}{name}"

    def length(self, name: str) -> int | None:
        """Length of the first axis of an array; None if the array is missing or has no axis.

        The array is not removed.
        """
        shape = np.shape(self._remaining.get(name, ()))
        return shape[0] if shape else None

    def take(self, name: str, dtype: Any, shape: tuple[int | str, ...]) -> np.ndarray:
        """Remove and return an array, after a check of its type and shape.

        Raises `ValueError` if the array is missing or has another type or shape. A string in
        `shape` stands for any length, and is the name of that axis in the message.
        """
        sizes = ", ".join(map(str, shape))
        requirement = f"`{self.full_name(name)}` must be {np.dtype(dtype)} [{sizes}]"
        if name not in self._remaining:
            raise ValueError(f"{requirement}; it is missing.")
        array = np.asarray(self._remaining.pop(name))
        fits = array.ndim == len(shape) and all(
            isinstance(size, str) or size == actual
            for size, actual in zip(shape, array.shape, strict=True)
        )
        if not fits or array.dtype != dtype:
            raise ValueError(f"{requirement}; got {array.dtype} {list(array.shape)}.")
        return array

    def finite(
        self,
        name: str,
        dtype: Any,
        shape: tuple[int | str, ...],
        low: float = -np.inf,
        high: float = np.inf,
    ) -> np.ndarray:
        """Remove and return an array; raise `ValueError` unless all of its numbers are finite.

        `ValueError` is also raised for a number outside `low`..`high`, whose ends are included, and
        as `take` does for the type and the shape.
        """
        array = self.take(name, dtype, shape)
        if not (np.isfinite(array) & (array >= low) & (array <= high)).all():
            bounds = "" if np.isinf([low, high]).all() else f" in {low:g}..{high:g}"
            raise ValueError(f"`{self.full_name(name)}` must hold finite numbers{bounds}.")
        return array

    def drop(self, name: str) -> None:
        """Remove an array, which must exist, without a check, because it is checked elsewhere."""
        self._remaining.pop(name)

    def end(self) -> None:
        """Raise `ValueError` if there is an array that has not been removed."""
        for name in self._remaining:
            shown = "".join(c if c.isprintable() else "?" for c in name[:80])
            raise ValueError(f"`{self.full_name(shown)}` is not an array of a saved fit.")


def read_json(name: str, data: np.ndarray) -> dict[str, Any]:
    """Parse the bytes of a saved array, the text of a JSON object, and return the object.

    `data`: the bytes. `name`: name of the array for the `ValueError` that is raised if they are
    anything else.
    """
    try:
        value = json.loads(data.tobytes().decode())
    except (ValueError, RecursionError):
        value = None
    if not isinstance(value, dict):
        raise ValueError(f"`{name}` must be an object in JSON.")
    return value
