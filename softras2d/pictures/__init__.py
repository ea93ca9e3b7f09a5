"""The bundled pictures, to be fitted where no photograph is at hand; `experiments/pictures` makes
them."""

from pathlib import Path

_SIZES = {"valley": (256, 384), "fruit": (256, 256)}


def names() -> tuple[str, ...]:
    """The bundled pictures."""
    return tuple(_SIZES)


def size(name: str) -> tuple[int, int]:
    """Height and width in pixels."""
    return _SIZES[name]


def path(name: str) -> Path:
    """The PNG file of a picture; `ValueError` for a name not in `names()`."""
    if name not in _SIZES:
        raise ValueError(f"no bundled picture {name!r}; there are {', '.join(_SIZES)}.")
    return Path(__file__).parent / f"{name}.png"
