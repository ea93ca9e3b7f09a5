"""A differentiable 2-D triangle rasterizer in JAX.

The names in `__all__` are public; everything else may change. They load on first use (PEP 562),
so that `import softras2d` costs milliseconds and a command line can answer `--help` without waiting
for JAX.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from . import camera, pictures, plot, testing
    from .comparison.compare import Comparison, compare
    from .fitting.batch import fit_batch
    from .fitting.fit import fit
    from .fitting.frames import fit_frames
    from .fitting.result import FitResult
    from .io.compact_scene import read_compact, write_compact
    from .io.images import read_image, write_image
    from .io.svg.reading.control_points import SvgControls
    from .io.svg.reading.reader import read_svg, read_svg_controls
    from .io.svg.writing.film import write_svg_film
    from .io.svg.writing.writer import write_svg
    from .numerics.compilation_cache import keep_compiled_programs
    from .options import Area, Filter, Hard, Soft
    from .planning.plan import Plan
    from .planning.simplify import simplify
    from .planning.size_classes import pad
    from .rendering.composite import composite
    from .rendering.find_pixel_layers import pixel_layers
    from .rendering.pixel_layers import PixelLayers
    from .rendering.planner import plan, plan_for
    from .rendering.render import render, render_checked
    from .rendering.replanning import value_and_grad_replanning
    from .rendering.resolve import resolve
    from .rendering.visibility import Visibility, interpolate, rasterize
    from .scene import Scene, check
    from .shading.sample_texture import sample_texture
    from .texture.pyramid import TexturePyramid
    from .tiled.plan_tiles import TiledPlan, plan_tiles
    from .tiled.render_tiles import render_tiles
    from .tiled.value_and_grad import tiled_value_and_grad
    from .tiled.write_tiles import write_tiles
    from .viewing.notebook import view

__version__ = "0.1.0"

_DEFINED_IN = {
    "Area": ".options",
    "Comparison": ".comparison.compare",
    "Filter": ".options",
    "FitResult": ".fitting.result",
    "Hard": ".options",
    "PixelLayers": ".rendering.pixel_layers",
    "Plan": ".planning.plan",
    "Scene": ".scene",
    "Soft": ".options",
    "SvgControls": ".io.svg.reading.control_points",
    "TexturePyramid": ".texture.pyramid",
    "TiledPlan": ".tiled.plan_tiles",
    "Visibility": ".rendering.visibility",
    "check": ".scene",
    "compare": ".comparison.compare",
    "composite": ".rendering.composite",
    "fit": ".fitting.fit",
    "fit_batch": ".fitting.batch",
    "fit_frames": ".fitting.frames",
    "interpolate": ".rendering.visibility",
    "keep_compiled_programs": ".numerics.compilation_cache",
    "pad": ".planning.size_classes",
    "pixel_layers": ".rendering.find_pixel_layers",
    "plan": ".rendering.planner",
    "plan_for": ".rendering.planner",
    "plan_tiles": ".tiled.plan_tiles",
    "rasterize": ".rendering.visibility",
    "read_compact": ".io.compact_scene",
    "read_image": ".io.images",
    "read_svg": ".io.svg.reading.reader",
    "read_svg_controls": ".io.svg.reading.reader",
    "render": ".rendering.render",
    "render_checked": ".rendering.render",
    "render_tiles": ".tiled.render_tiles",
    "resolve": ".rendering.resolve",
    "sample_texture": ".shading.sample_texture",
    "simplify": ".planning.simplify",
    "tiled_value_and_grad": ".tiled.value_and_grad",
    "value_and_grad_replanning": ".rendering.replanning",
    "view": ".viewing.notebook",
    "write_compact": ".io.compact_scene",
    "write_image": ".io.images",
    "write_svg": ".io.svg.writing.writer",
    "write_svg_film": ".io.svg.writing.film",
    "write_tiles": ".tiled.write_tiles",
}

_PUBLIC_MODULES = ("camera", "pictures", "plot", "testing")
"""Modules that are public as a whole."""

__all__ = [
    "Area",
    "Comparison",
    "Filter",
    "FitResult",
    "Hard",
    "PixelLayers",
    "Plan",
    "Scene",
    "Soft",
    "SvgControls",
    "TexturePyramid",
    "TiledPlan",
    "Visibility",
    "camera",
    "check",
    "compare",
    "composite",
    "fit",
    "fit_batch",
    "fit_frames",
    "interpolate",
    "keep_compiled_programs",
    "pad",
    "pictures",
    "pixel_layers",
    "plan",
    "plan_for",
    "plan_tiles",
    "plot",
    "rasterize",
    "read_compact",
    "read_image",
    "read_svg",
    "read_svg_controls",
    "render",
    "render_checked",
    "render_tiles",
    "resolve",
    "sample_texture",
    "simplify",
    "testing",
    "tiled_value_and_grad",
    "value_and_grad_replanning",
    "view",
    "write_compact",
    "write_image",
    "write_svg",
    "write_svg_film",
    "write_tiles",
]


def __getattr__(name: str):
    """Load a public name or module on its first use, and keep it in this module (PEP 562).

    Python calls this function for names that are not attributes of the module yet. Raises
    `AttributeError` for names that are not public.
    """
    if name in _PUBLIC_MODULES:
        # The import system makes it an attribute of this module, so this runs once.
        return import_module(f".{name}", __name__)
    if name not in _DEFINED_IN:
        raise AttributeError(f"module 'softras2d' has no attribute {name!r}")
    value = getattr(import_module(_DEFINED_IN[name], __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """List the public names, also those that have not been loaded yet."""
    return sorted(__all__)
