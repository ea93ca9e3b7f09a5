"""Reads, plans and renders one scene as the options of a command say.

This module imports JAX, so it is imported only while a command runs.
"""

import dataclasses
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ..color import srgb_to_linear
from ..numerics.device import to_device
from ..options import Area, Coverage, Filter, Hard, Soft
from ..planning.plan import Plan
from ..rendering.planner import plan
from ..rendering.render import render_checked
from ..scene import Scene
from ..tiled.plan_tiles import TiledPlan, plan_tiles
from .options import RenderOptions, Size
from .scene_sources import SceneSource


def read_scene(path: Path, options: RenderOptions) -> tuple[Scene, int, int]:
    """Read a scene; return the scene, and the height and width of its canvas in pixels.

    `path` is a file, `-` for standard input, or the name of a bundled scene. If the options give a
    background, it replaces that of the scene. If they give a canvas with another aspect ratio than
    the drawing, and `options.fit` does not say how to fill the canvas, a warning says that margins
    remain. There is none in dialect `course`.
    """
    source = SceneSource(path, options.dialect)
    has_both_sides = options.size is not None and options.size.height is not None
    file_size = None if has_both_sides else source.size()
    height, width = canvas_size(options.size, file_size)
    if has_both_sides and options.fit is None and options.dialect == "svg":
        _warn_of_margins(source, height, width)
    scene = source.read(
        height=height,
        width=width,
        assets=options.assets,
        opacity=options.opacity,
        frame=options.frame,
        linear=options.linear,
        tolerance=options.tolerance,
        strict=options.strict,
        fit=options.fit,
    )
    if options.background is not None:
        # Three channels make the image opaque, four give it an alpha channel.
        channels = 3 if options.background.alpha == 1 else 4
        color = np.asarray(options.background[:channels], np.float32)
        if options.linear:
            color[:3] = srgb_to_linear(color[:3])
        scene = dataclasses.replace(scene, background=to_device(color))
    return scene, height, width


def _warn_of_margins(source: SceneSource, height: int, width: int) -> None:
    """Warn if the drawing would leave margins on a canvas of `height` x `width` pixels.

    Errors of reading the drawing are ignored here.
    """
    try:
        size = source.size_with_margins(height, width)
    except ValueError:
        return
    if size is not None:
        warnings.warn(
            f"{source.path}: drawn with margins, because the drawing is {size[1]:g} x "
            f"{size[0]:g}; use --fit contain, cover or stretch.",
            UserWarning,
            stacklevel=2,
        )


def canvas_size(size: Size | None, file_size: tuple[int, int] | None) -> tuple[int, int]:
    """Choose the (height, width) of the canvas in pixels.

    - `size`: value of the option `--size`. If it has no height, its width is the length of the
      longer side; the other side follows from the aspect ratio of `file_size`, rounded, and is at
      least 1.
    - `file_size`: the (height, width) that the scene file declares, which is the result without
      `size`. It may be None if `size` has a height.
    """
    if size is not None and size.height is not None:
        return size.height, size.width
    assert file_size is not None
    if size is None:
        return file_size
    scale = size.width / max(file_size)
    height, width = (max(1, round(side * scale)) for side in file_size)
    return height, width


def window_size(window: Size | None, height: int, width: int) -> tuple[int, int]:
    """Choose the (height, width) of the image in pixels, if the drawing has `height` x `width`.

    `window` is the value of the option `--window`, the size of the image; without it, the image
    shows the drawing in full. Raises `ValueError` for a window without height.
    """
    if window is None:
        return height, width
    if window.height is None:
        raise ValueError(f"--window must be WIDTHxHEIGHT, such as 800x600; got {window.width}.")
    return window.height, window.width


def make_plan(scene: Scene, height: int, width: int, options: RenderOptions) -> Plan:
    """Plan to render an image of `height` x `width` pixels, as the options say.

    Raises `ValueError` for invalid options, with a message in which `_IN_OPTIONS` are replaced.
    """
    with _errors_name_options():
        return plan(scene, height=height, width=width, **_plan_arguments(options))


def make_tiled_plan(
    scene: Scene, height: int, width: int, options: RenderOptions, tile: int | None
) -> TiledPlan:
    """Plan to render an image of `height` x `width` pixels in tiles, as the options say.

    `tile` is the side of a tile in pixels, or None for the default. Raises `ValueError` for invalid
    options, with a message in which `_IN_OPTIONS` are replaced.
    """
    with _errors_name_options():
        return plan_tiles(scene, height=height, width=width, tile=tile, **_plan_arguments(options))


_IN_OPTIONS = {
    "in pieces, with `origin`": "with softras2d render --tiled",
    "`width` must be one number of pixels above 0": "--soft-width must be a number above 0",
    "`lod_bias`": "--lod-bias",
    "`origin`": "--origin",
    "`samples`": "--samples",
    "`tile`": "--tile",
}
"""Texts in errors of `plan` and `plan_tiles`, and what the command line says instead."""


@contextmanager
def _errors_name_options() -> Iterator[None]:
    """In a `with` block, replace the texts `_IN_OPTIONS` in the message of a `ValueError`."""
    try:
        yield
    except ValueError as error:
        message = str(error)
        for argument, option in _IN_OPTIONS.items():
            message = message.replace(argument, option)
        raise ValueError(message) from error


def _plan_arguments(options: RenderOptions) -> dict[str, Any]:
    """Convert the options of a command to keyword arguments that `plan` and `plan_tiles` share.

    They are `coverage`, `filter` and `origin`.
    """
    coverage: Coverage = {
        "sampled": lambda: Hard(options.samples, options.fill_rule, options.shading),
        "soft": lambda: Soft(options.soft_width),
        "area": Area,
    }[options.coverage]()
    return {
        "coverage": coverage,
        "filter": Filter(
            pixel=options.pixel_filter,
            level=options.level_filter,
            anisotropy=options.anisotropy,
            lod_bias=options.lod_bias,
        ),
        "origin": (0, 0) if options.origin is None else tuple(options.origin),
    }


def render_image(scene: Scene, plan: Plan) -> np.ndarray:
    """Render a scene to a NumPy image `[height, width, channels]` of floats, as `render` does.

    Raises `ValueError` if the scene exceeds a capacity of the plan, so that an image never lacks
    triangles.
    """
    image, overflow = render_checked(scene, plan)
    if bool(overflow):
        raise ValueError("the scene exceeds the capacity of its plan.")
    return np.asarray(image)


def scene_properties(scene: Scene) -> list[tuple[str, str]]:
    """Pairs of name and value, both texts, that describe a scene in a table.

    They are about triangles, colours and background and, if the scene has them, about textures,
    depth and perspective.
    """
    triangles, corners, channels = scene.colors.shape
    colors = "flat" if corners == 1 else "one per corner"
    alpha = "opaque" if channels == 3 else "with alpha"
    properties = [
        ("triangles", f"{triangles:,} over {scene.positions.shape[0]:,} vertices"),
        ("colours", f"{colors}, {alpha}"),
        ("background", " ".join(f"{float(value):.3g}" for value in scene.background)),
    ]
    if scene.textures is not None:
        properties.append(("textures", f"{scene.textures.count} ({scene.textures.border})"))
    if scene.depth is not None:
        properties.append(("depth", "nearest in front"))
    if scene.inverse_w is not None:
        properties.append(("perspective", "yes"))
    return properties
