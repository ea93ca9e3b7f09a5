"""A differentiable 2-D triangle rasterizer in JAX.

The names below are the public face; everything else may change. They load on first use
(PEP 562), so that `import softras2d` costs milliseconds and a command line can answer `--help`
without waiting for JAX.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from . import camera, pictures, plot
    from .fit.batch import fit_batch
    from .fit.fit import fit
    from .fit.result import FitResult
    from .io.images import read_image, write_image
    from .io.svg import read_svg
    from .io.svg_writer import write_svg
    from .options import Area, Filter, Hard, Soft
    from .plan import Plan, plan
    from .render import render, render_checked
    from .scene import Scene, check
    from .simplify import simplify
    from .size_classes import pad
    from .texture.pyramid import TexturePyramid

__version__ = "0.1.0"

_HOMES = {
    "Area": ".options",
    "Filter": ".options",
    "FitResult": ".fit.result",
    "Hard": ".options",
    "Plan": ".plan",
    "Scene": ".scene",
    "Soft": ".options",
    "TexturePyramid": ".texture.pyramid",
    "check": ".scene",
    "fit": ".fit.fit",
    "fit_batch": ".fit.batch",
    "pad": ".size_classes",
    "plan": ".plan",
    "read_image": ".io.images",
    "read_svg": ".io.svg",
    "render": ".render",
    "render_checked": ".render",
    "simplify": ".simplify",
    "write_image": ".io.images",
    "write_svg": ".io.svg_writer",
}

_ROOMS = ("camera", "pictures", "plot")
"""Modules that are public as a whole."""

__all__ = [
    "Area",
    "Filter",
    "FitResult",
    "Hard",
    "Plan",
    "Scene",
    "Soft",
    "TexturePyramid",
    "camera",
    "check",
    "fit",
    "fit_batch",
    "pad",
    "pictures",
    "plan",
    "plot",
    "read_image",
    "read_svg",
    "render",
    "render_checked",
    "simplify",
    "write_image",
    "write_svg",
]


class _Package(ModuleType):
    """This package; where a function is named like the room it lives in, the function is meant."""

    def __setattr__(self, name: str, value: object) -> None:
        # The import system would put the submodules `plan`, `render`, `simplify` here.
        if not (name in _HOMES and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str):
    if name in _ROOMS:
        # The import system puts it here.
        return import_module(f".{name}", __name__)
    if name not in _HOMES:
        raise AttributeError(f"module 'softras2d' has no attribute {name!r}")
    value = getattr(import_module(_HOMES[name], __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
