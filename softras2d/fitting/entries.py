"""Arrays of a saved fit by name, each checked for its type, shape and range before it is used."""

import json
from typing import Any, NamedTuple

import numpy as np

TINY = float(np.finfo(np.float32).tiny)
"""The smallest normal float32: the lower bound of what must be above zero."""


class Size(NamedTuple):
    """Size of an image in pixels, and its number of channels."""

    height: int
    width: int
    channels: int


class Entries:
    """Arrays by name, each of which can be taken once. Those left at the end belong to no fit.

    `prefix`: what the names begin with in error messages.
    """

    def __init__(self, arrays: dict[str, Any], prefix: str = ""):
        self._left = dict(arrays)
        self._prefix = prefix

    def __contains__(self, name: str) -> bool:
        return name in self._left

    def full_name(self, name: str) -> str:
        """The name of an entry as error messages show it."""
        return f"{self._prefix}{name}"

    def length(self, name: str) -> int | None:
        """Length of an entry's first axis, without taking the entry; None if it has no axis."""
        shape = np.shape(self._left.get(name, ()))
        return shape[0] if shape else None

    def take(self, name: str, dtype: Any, shape: tuple[int | str, ...]) -> np.ndarray:
        """Take the array of this type and shape; raise `ValueError` if it is missing or another.

        A word in `shape` stands for any length, and names it in the error.
        """
        sizes = ", ".join(map(str, shape))
        wanted = f"`{self.full_name(name)}` must be {np.dtype(dtype)} [{sizes}]"
        if name not in self._left:
            raise ValueError(f"{wanted}; it is missing.")
        array = np.asarray(self._left.pop(name))
        fits = array.ndim == len(shape) and all(
            isinstance(size, str) or size == actual
            for size, actual in zip(shape, array.shape, strict=True)
        )
        if not fits or array.dtype != dtype:
            raise ValueError(f"{wanted}; got {array.dtype} {list(array.shape)}.")
        return array

    def finite(
        self,
        name: str,
        dtype: Any,
        shape: tuple[int | str, ...],
        low: float = -np.inf,
        high: float = np.inf,
    ) -> np.ndarray:
        """`take` an array that must also hold finite numbers from `low` to `high`."""
        array = self.take(name, dtype, shape)
        if not (np.isfinite(array) & (array >= low) & (array <= high)).all():
            between = "" if np.isinf([low, high]).all() else f" in {low:g}..{high:g}"
            raise ValueError(f"`{self.full_name(name)}` must hold finite numbers{between}.")
        return array

    def drop(self, name: str) -> None:
        """Accept an array unseen, because it is checked elsewhere."""
        self._left.pop(name)

    def end(self) -> None:
        """Raise `ValueError` if an entry is left."""
        for name in self._left:
            shown = "".join(c if c.isprintable() else "?" for c in name[:80])
            raise ValueError(f"`{self.full_name(shown)}` is no entry of a fit.")


def read_json(name: str, data: np.ndarray) -> dict[str, Any]:
    """The JSON object in an entry's bytes; `ValueError` names the entry."""
    try:
        value = json.loads(data.tobytes().decode())
    except (ValueError, RecursionError):
        value = None
    if not isinstance(value, dict):
        raise ValueError(f"`{name}` must be an object in JSON.")
    return value
