"""The bundled scenes: pictures of 300 x 300 pixels, each made to show one thing.

Most are SVG files, whose purpose stands in their first comment; some of these are written by
`experiments/bundled_scenes`. Those in space are made by `scripted.py` through the camera.
"""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ..scene import Scene

SIZE = 300
"""Height and width of every scene in pixels. One size lets scenes share compiled programs."""

_FILES = (
    "hairlines",
    "outlines",
    "slivers",
    "joints",
    "wheel",
    "rings",
    "squares",
    "glass",
    "mesh",
    "minified",
    "zone_plate",
    "stretched",
    "magnified",
)

_SCRIPTED = ("ground", "overlap", "crossing")

_KEYWORDS: dict[str, dict[str, Any]] = {"hairlines": {"dialect": "course"}}
"""How scenes that are about something other than standard SVG are read."""

_FIRST_COMMENT = re.compile(r"<!--(.*?)-->", re.DOTALL)


def names() -> tuple[str, ...]:
    """The bundled scenes, in the order in which they are shown."""
    return _FILES + _SCRIPTED


def is_scripted(name: str) -> bool:
    """Whether a bundled scene is made by script, not read from a file.

    Raises `ValueError` for a name not in `names()`.
    """
    if name not in names():
        raise ValueError(f"no bundled scene {name!r}; there are {', '.join(names())}.")
    return name in _SCRIPTED


def path(name: str) -> Path:
    """The SVG file of a bundled scene. Raises `ValueError` if there is none: see `read`."""
    if is_scripted(name):
        raise ValueError(f"the bundled scene {name!r} has no file; scenes.read({name!r}) makes it.")
    return Path(__file__).parent / f"{name}.svg"


def purpose(name: str) -> str:
    """What a bundled scene shows, in one sentence on one line."""
    if is_scripted(name):
        from .scripted import SCRIPTED

        return SCRIPTED[name].purpose
    comment = _FIRST_COMMENT.search(path(name).read_text(encoding="utf-8"))
    assert comment is not None, f"{name}.svg has no comment that says its purpose"
    return " ".join(comment.group(1).split())


def read(name: str, **keywords: Any) -> "Scene":
    """A bundled scene, for a canvas of `height` x `width` pixels, 300 x 300 unless given.

    `keywords` are those of `read_svg`, in the scene's own dialect; a scripted scene takes
    `height` and `width` alone.
    """
    if is_scripted(name):
        from .scripted import SCRIPTED

        return SCRIPTED[name].make(**({"height": SIZE, "width": SIZE} | keywords))
    from ..io.svg.reader import read_svg

    return read_svg(path(name), **(_KEYWORDS.get(name, {}) | keywords))
