"""Bundled scenes of 300 x 300 pixels, each of which shows one property of rasterization.

Most are SVG files, whose first comment states their purpose; `experiments/bundled_scenes` writes
some of these files. The scenes in three dimensions have no file: Python functions in `scripted.py`
make them, so they are called scripted.
"""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..names import SvgDialect

if TYPE_CHECKING:
    from ..scene import Scene

SIZE = 300
"""Height and width of every scene, in pixels. Scenes of one size can share compiled programs."""

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

_READ_OPTIONS: dict[str, dict[str, Any]] = {"hairlines": {"dialect": "course"}}
"""Arguments of `read_svg` for scenes that are not standard SVG."""

_FIRST_COMMENT = re.compile(r"<!--(.*?)-->", re.DOTALL)


def names() -> tuple[str, ...]:
    """The names of all bundled scenes, in the order in which they are shown."""
    return _FILES + _SCRIPTED


def is_scripted(name: str) -> bool:
    """Whether a bundled scene is made by a function instead of being read from a file.

    Raises `ValueError` for a name that is not in `names()`.
    """
    if name not in names():
        raise ValueError(f"no bundled scene {name!r}; there are {', '.join(names())}.")
    return name in _SCRIPTED


def is_bundled(path: Path) -> bool:
    """Whether a path is the name of a bundled scene, and no file or folder of that name exists."""
    return str(path) in names() and not path.exists()


def path(name: str) -> Path:
    """The SVG file of the bundled scene `name`.

    Raises `ValueError` for a name that is not in `names()`, and for a scripted scene, which has no
    file.
    """
    if is_scripted(name):
        raise ValueError(f"the bundled scene {name!r} has no file; scenes.read({name!r}) makes it.")
    return Path(__file__).parent / f"{name}.svg"


def dialect(name: str) -> SvgDialect:
    """The dialect of SVG, `"svg"` or `"course"`, in which the file of a bundled scene is written.

    It is `"svg"` for a scene without a file, and for any other name.
    """
    return _READ_OPTIONS.get(name, {}).get("dialect", "svg")


def purpose(name: str) -> str:
    """What the bundled scene `name` shows: one sentence, on one line.

    Raises `ValueError` for a name that is not in `names()`.
    """
    if is_scripted(name):
        from .scripted import SCRIPTED

        return SCRIPTED[name].purpose
    comment = _FIRST_COMMENT.search(path(name).read_text(encoding="utf-8"))
    assert comment is not None, f"{name}.svg has no comment that says its purpose"
    return " ".join(comment.group(1).split())


def read(name: str, **keywords: Any) -> "Scene":
    """Read the file of the bundled scene `name`, or make the scene if it is scripted.

    `keywords`: arguments of `read_svg`, such as `height` and `width` of the canvas in pixels, 300
    by default. The default of `dialect` is the dialect in which the file is written. A scripted
    scene accepts only `height` and `width`. Raises `ValueError` for a name that is not in
    `names()`.
    """
    if is_scripted(name):
        from .scripted import SCRIPTED

        return SCRIPTED[name].make(**({"height": SIZE, "width": SIZE} | keywords))
    from ..io.svg.reading.reader import read_svg

    return read_svg(path(name), **(_READ_OPTIONS.get(name, {}) | keywords))
