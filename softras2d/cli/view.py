"""From a scene's file to its picture, as the options say. Imports JAX: for use within a command."""

import dataclasses
from pathlib import Path

import numpy as np

from ..io.images import srgb_to_linear
from ..io.svg.reader import read_svg, svg_size
from ..numerics.device import to_device
from ..options import Filter, Hard
from ..planning.plan import Plan
from ..rendering.planner import plan
from ..rendering.render import render_checked
from ..scene import Scene
from .options import Size, View


def read(path: Path, view: View) -> tuple[Scene, int, int]:
    """The scene in a file, and the height and width of its picture in pixels."""
    own = None if view.size and view.size.height else svg_size(path, dialect=view.dialect)
    height, width = canvas(view.size, own)
    scene = read_svg(
        path,
        height=height,
        width=width,
        dialect=view.dialect,
        assets=view.assets,
        opacity=view.opacity,
        frame=view.frame,
        linear=view.linear,
    )
    if view.background is not None:
        # An opaque background is one channel less: the picture has no alpha then.
        channels = 3 if view.background.alpha == 1 else 4
        color = np.asarray(view.background[:channels], np.float32)
        if view.linear:
            color[:3] = srgb_to_linear(color[:3])
        scene = dataclasses.replace(scene, background=to_device(color))
    return scene, height, width


def canvas(size: Size | None, own: tuple[int, int] | None) -> tuple[int, int]:
    """Height and width of a picture; where `size` leaves one open, the scene's `own` decide."""
    if size is not None and size.height is not None:
        return size.height, size.width
    assert own is not None
    if size is None:
        return own
    scale = size.width / max(own)
    height, width = (max(1, round(side * scale)) for side in own)
    return height, width


def plan_of(scene: Scene, height: int, width: int, view: View) -> Plan:
    """The plan of a hard picture."""
    return plan(
        scene,
        height=height,
        width=width,
        coverage=Hard(samples=view.samples, fill_rule=view.fill_rule, shading=view.shading),
        filter=Filter(pixel=view.pixel_filter, level=view.level_filter, anisotropy=view.anisotropy),
        origin=(0, 0) if view.origin is None else tuple(view.origin),
    )


def draw(scene: Scene, plan: Plan) -> np.ndarray:
    """The picture, whole or not at all: an overflow raises `ValueError`."""
    image, overflow = render_checked(scene, plan)
    if bool(overflow):
        raise ValueError("the scene needs more room than its plan has.")
    return np.asarray(image)


def facts(scene: Scene) -> list[tuple[str, str]]:
    """What the scene holds, by name."""
    triangles, corners, channels = scene.colors.shape
    found = [
        ("triangles", f"{triangles:,} over {scene.positions.shape[0]:,} vertices"),
        (
            "colours",
            ("flat" if corners == 1 else "one a corner")
            + (", opaque" if channels == 3 else ", with alpha"),
        ),
        ("background", " ".join(f"{float(value):.3g}" for value in scene.background)),
    ]
    if scene.textures is not None:
        found.append(("textures", f"{scene.textures.count} ({scene.textures.border})"))
    if scene.depth is not None:
        found.append(("depth", "nearest in front"))
    if scene.inverse_w is not None:
        found.append(("perspective", "yes"))
    return found
