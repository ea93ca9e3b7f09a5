"""The bundled scenes: SVG files of 300 x 300 pixels, each drawn to show one thing.

Their purpose stands in the first comment of each file. Some are written by `make.py`.
"""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..scene import Scene

_NAMES = (
    "hairlines",
    "outlines",
    "slivers",
    "joints",
    "wheel",
    "rings",
    "squares",
    "glass",
    "mesh",
)

_KEYWORDS: dict[str, dict[str, Any]] = {"hairlines": {"dialect": "course"}}
"""How scenes that are about something other than standard SVG are read."""

_FIRST_COMMENT = re.compile(r"<!--\s*(.*?)\s*-->", re.DOTALL)


def names() -> tuple[str, ...]:
    """The bundled scenes, in the order in which they are shown."""
    return _NAMES


def path(name: str) -> Path:
    """The SVG file of a bundled scene. Raises `ValueError` for a name not in `names()`."""
    if name not in _NAMES:
        raise ValueError(f"no bundled scene {name!r}; there are {', '.join(_NAMES)}.")
    return Path(__file__).parent / f"{name}.svg"


def purpose(name: str) -> str:
    """What a bundled scene shows, in one sentence on one line."""
    comment = _FIRST_COMMENT.search(path(name).read_text(encoding="utf-8"))
    assert comment is not None, f"{name}.svg has no comment that says its purpose"
    return " ".join(comment.group(1).split())


def read(name: str, **keywords: Any) -> "Scene":
    """A bundled scene through `read_svg`, with its `keywords` and in the scene's own dialect."""
    from ..io.svg import read_svg

    return read_svg(path(name), **(_KEYWORDS.get(name, {}) | keywords))
