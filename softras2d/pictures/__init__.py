"""The bundled pictures, as targets of fits where no photograph is at hand.

`experiments/pictures` makes them.
"""

from pathlib import Path

_SIZES = {"valley": (256, 384), "fruit": (256, 256)}


def names() -> tuple[str, ...]:
    """The names of all bundled pictures."""
    return tuple(_SIZES)


def size(name: str) -> tuple[int, int]:
    """Height and width of a bundled picture, in pixels.

    Raises `ValueError` for a name that is not in `names()`.
    """
    _check(name)
    return _SIZES[name]


def path(name: str) -> Path:
    """The PNG file of a bundled picture; `ValueError` for a name that is not in `names()`."""
    _check(name)
    return Path(__file__).parent / f"{name}.png"


def _check(name: str) -> None:
    """Raise `ValueError` for a name that is not in `names()`."""
    if name not in _SIZES:
        raise ValueError(f"no bundled picture {name!r}; there are {', '.join(_SIZES)}.")
