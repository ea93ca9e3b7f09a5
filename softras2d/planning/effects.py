"""Effects that a render may draw, each of which is a row of the table `EFFECTS`.

An effect is a feature of a scene or of the options that costs time, such as texture or
translucency. A scene pays only for the effects that it calls for. Whether it calls for an effect
mostly follows from the shapes of its arrays and from the arrays that it leaves out. So the compiled
program of a scene without an effect does not contain the effect.

The rows serve plans, reports and `simplify`. The stages that draw an effect look for themselves at
the same arrays, such as `scene.depth`.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Int

from ..geometry.canvas_grid import Grid
from ..geometry.fixed_point import snapped_corners, within_guard
from ..numerics.device import to_device
from ..options import Coverage, Filter, Hard
from ..scene import Scene, take_triangles


class Drawing(NamedTuple):
    """A scene and how it is drawn.

    The scene's arrays are concrete, or only shapes where a plan looks at no values.

    - `grid`: size of the canvas, samples per pixel, and fixed-point grid.
    - `origin`: the point (x, y) of the scene, in whole pixels, at the canvas's upper left.
    """

    scene: Scene
    coverage: Coverage
    filter: Filter
    grid: Grid
    origin: np.ndarray | Int[Array, "2"]


class Effect(NamedTuple):
    """One effect of a render: a feature that costs time, such as texture or translucency.

    - `reason`: text that tells a user what in the scene or in the options calls for the effect.
    - `is_present`: whether a drawing calls for the effect. It does not ask whether the drawing's
      coverage mode has such an effect; the lists of effects in `rendering.coverage_mode` say that.
    - `without`: returns the drawing without the effect. `rendering.cost` compares the costs of the
      two drawings, and `simplify` removes effects that do not show.
    """

    reason: str
    is_present: Callable[[Drawing], bool]
    without: Callable[[Drawing], Drawing]


def is_translucent(scene: Scene) -> bool:
    """Whether colours or textures have an alpha channel; if so, all triangles are composited."""
    textures = scene.textures
    return scene.colors.shape[-1] == 4 or (textures is not None and textures.channels == 4)


def varies(scene: Scene) -> bool:
    """Whether the colour of a triangle may differ from point to point within the triangle.

    Only the structure of the scene decides: it is true for a scene with textures or with three
    corner colours per triangle, whatever their values are.
    """
    return scene.textures is not None or scene.colors.shape[-2] == 3


def is_shaded(scene: Scene, shading: str) -> bool:
    """Whether sampled coverage has to evaluate the colours of a scene point by point.

    This is so for a scene with textures, and for corner colours that are interpolated in
    perspective or evaluated once per pixel. `shading` is `Hard.shading`. If the result is false,
    the colour of each triangle is affine on the screen, and is taken at each sample. The sum of the
    colours over covered samples then follows from the number of these samples and the sums of their
    columns and rows.
    """
    is_not_affine = scene.inverse_w is not None or shading == "pixel"
    return scene.textures is not None or (varies(scene) and is_not_affine)


def _is_pixel_shaded(drawing: Drawing) -> bool:
    """Whether colours vary within a triangle and are evaluated once per pixel and triangle.

    It is false under `Soft` and `Area`, which have no option `shading`.
    """
    shading = getattr(drawing.coverage, "shading", "sample")
    return shading == "pixel" and varies(drawing.scene)


def _within_guard_band(drawing: Drawing) -> np.ndarray:
    """Whether each triangle lies within the guard band (`Grid.margin`), `[triangles]`.

    The guard band is the canvas with a wide margin. The result is also true for padding and for
    triangles with a corner that is not finite.
    """
    positions, triangles, origin = (
        np.asarray(array)
        for array in (drawing.scene.positions, drawing.scene.triangles, drawing.origin)
    )
    guard = np.array(drawing.grid.guard, positions.dtype)
    # Snapping moves a vertex by less than a pixel, so this needs no snapped corners.
    if all(
        _lies_a_pixel_inside(
            positions[:, axis] - origin[axis].astype(positions.dtype), *guard[:, axis]
        )
        for axis in (0, 1)
    ):
        return np.ones(len(triangles), bool)
    corners = snapped_corners(positions, triangles, origin, drawing.grid)
    return np.asarray(within_guard(corners, drawing.grid))


def _lies_a_pixel_inside(coordinates: np.ndarray, low: np.floating, high: np.floating) -> bool:
    """Whether all coordinates, in pixels, are at least a pixel inside `low..high`.

    It is false if one of them is NaN, and true if there are no coordinates.
    """
    if coordinates.size == 0:
        return True
    return bool(coordinates.min() >= low + 1 and coordinates.max() <= high - 1)


def _has_mip_levels(drawing: Drawing) -> bool:
    """Whether textures have levels above the base, and the filter reads them."""
    textures = drawing.scene.textures
    return textures is not None and textures.depth > 1 and drawing.filter.level != "zero"


def _replace_scene(drawing: Drawing, **fields: Any) -> Drawing:
    """Return the drawing with these fields of its scene replaced."""
    return drawing._replace(scene=replace(drawing.scene, **fields))


def _replace_filter(drawing: Drawing, **fields: Any) -> Drawing:
    """Return the drawing with these fields of its filter replaced."""
    return drawing._replace(filter=replace(drawing.filter, **fields))


def _with_first_corner_colors(drawing: Drawing) -> Drawing:
    """Return the drawing with flat triangles, in the colours of their first corners."""
    # On the host, where no program is compiled for the shape.
    colors = to_device(np.asarray(drawing.scene.colors)[:, :1])
    return _replace_scene(drawing, colors=colors)


def _without_alpha(drawing: Drawing) -> Drawing:
    """Return the drawing without the alpha channels of colours and texels."""
    textures = drawing.scene.textures
    if textures is not None:
        textures = replace(textures, texels=textures.texels[:, :3])
    return _replace_scene(drawing, colors=drawing.scene.colors[..., :3], textures=textures)


def _with_hard_coverage(drawing: Drawing) -> Drawing:
    """Return the drawing with sampled coverage of one sample per pixel."""
    return drawing._replace(coverage=Hard(samples=1))


GUARD_BAND = "guard band"

EFFECTS = {
    "interpolated colour": Effect(
        "`colors` have three corners",
        lambda drawing: drawing.scene.colors.shape[-2] == 3,
        _with_first_corner_colors,
    ),
    "translucency": Effect(
        "`colors` or `textures` have an alpha channel",
        lambda drawing: is_translucent(drawing.scene),
        _without_alpha,
    ),
    "translucent background": Effect(
        "`background` has an alpha channel",
        lambda drawing: drawing.scene.background.shape[-1] == 4,
        lambda drawing: _replace_scene(drawing, background=drawing.scene.background[:3]),
    ),
    "texture": Effect(
        "`textures`",
        lambda drawing: drawing.scene.textures is not None,
        lambda drawing: _replace_scene(drawing, uv=None, texture_index=None, textures=None),
    ),
    "mip levels": Effect(
        "`textures` has levels, and `filter.level` is not 'zero'",
        _has_mip_levels,
        lambda drawing: _replace_filter(drawing, level="zero"),
    ),
    "bilinear filter": Effect(
        "`textures`, and `filter.pixel` is 'bilinear'",
        lambda drawing: drawing.scene.textures is not None and drawing.filter.pixel == "bilinear",
        lambda drawing: _replace_filter(drawing, pixel="nearest"),
    ),
    "anisotropic filter": Effect(
        "`textures`, and `filter.anisotropy` is above 1",
        lambda drawing: drawing.scene.textures is not None and drawing.filter.anisotropy > 1,
        lambda drawing: _replace_filter(drawing, anisotropy=1),
    ),
    "perspective": Effect(
        "`inverse_w`, which bends colours or texture coordinates",
        lambda drawing: drawing.scene.inverse_w is not None and varies(drawing.scene),
        lambda drawing: _replace_scene(drawing, inverse_w=None),
    ),
    "depth test": Effect(
        "`depth`",
        lambda drawing: drawing.scene.depth is not None,
        lambda drawing: _replace_scene(drawing, depth=None),
    ),
    "pixel shading": Effect(
        "`coverage.shading` is 'pixel', and colours vary within a triangle",
        _is_pixel_shaded,
        lambda drawing: drawing._replace(coverage=replace(drawing.coverage, shading="sample")),
    ),
    "soft coverage": Effect("`coverage` is `Soft`", lambda drawing: True, _with_hard_coverage),
    "exact area": Effect("`coverage` is `Area`", lambda drawing: True, _with_hard_coverage),
    GUARD_BAND: Effect(
        "triangles reach past the guard band around the canvas",
        lambda drawing: not _within_guard_band(drawing).all(),
        lambda drawing: drawing._replace(
            scene=take_triangles(drawing.scene, _within_guard_band(drawing))
        ),
    ),
}
"""Every effect by its name, in the order in which plans list them."""

SCENE_EFFECTS = frozenset(
    {
        "interpolated colour",
        "translucency",
        "translucent background",
        "texture",
        "mip levels",
        "bilinear filter",
        "anisotropic filter",
        "perspective",
    }
)
"""Names of the effects of colours and textures, which every coverage mode draws."""


def is_occluder(scene: Scene, orientation: Any) -> Any:
    """Whether each triangle is known to be opaque wherever it covers, hiding what is behind it.

    `orientation`, the sign of each triangle's area, and the result are `[triangles]`. The result is
    false for triangles without area, for triangles with an alpha below 1 at a corner, and for
    triangles with a texture if textures have alpha. It is false for all triangles of a scene with
    depth, because draw order does not tell there which triangle is behind. Works for NumPy and JAX
    alike.
    """
    xp = orientation.__array_namespace__()
    solid = orientation != 0
    if scene.depth is not None:
        return xp.zeros_like(solid)
    if scene.colors.shape[2] == 4:
        solid = solid & xp.all(scene.colors[..., 3] >= 1, axis=1)
    textures, index = scene.textures, scene.texture_index
    if textures is not None and index is not None and textures.channels == 4:
        solid = solid & (index < 0)
    return solid
