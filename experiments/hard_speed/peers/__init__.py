"""Peers that pip installs: 2-D libraries, each used in its fastest way on one thread.

For all of them, coordinates and colours are converted beforehand to the numbers that the calls of
the library take, and canvases are made once and reused. The time includes building paths, clearing,
drawing and, on a large canvas, the box filter. A peer that is not installed is left out.
"""

import importlib

from ...common.scenes import Soup
from ..contestant import Contestant

# Module of this folder, and the library that it needs.
_NEEDS = {
    "with_skia": "skia",
    "with_blend2d": "blend2d",
    "with_cairo": "cairo",
    "with_opencv": "cv2",
}


def contestants(soup: Soup) -> list[Contestant]:
    """The renderers of the installed peers for this kind of scene."""
    found: list[Contestant] = []
    for name in _NEEDS:
        if name not in missing():
            found += importlib.import_module(f".{name}", __name__).contestants(soup)
    return found


def missing() -> list[str]:
    """Modules of this folder whose library is not installed."""
    return [name for name, library in _NEEDS.items() if not _installed(library)]


def _installed(library: str) -> bool:
    try:
        importlib.import_module(library)
    except ImportError:
        return False
    return True
