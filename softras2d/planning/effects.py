"""Which effects a scene and a plan call for, read from structure: what is absent costs nothing."""

from typing import Any

from ..options import Area, Filter, Hard, Soft
from ..scene import Scene

EFFECTS = {
    "interpolated colour": "`colors` have three corners",
    "translucency": "`colors` or `textures` have an alpha channel",
    "translucent background": "`background` has an alpha channel",
    "texture": "`textures`",
    "mip levels": "`textures` has levels, and `filter.level` is not 'zero'",
    "bilinear filter": "`textures`, and `filter.pixel` is 'bilinear'",
    "anisotropic filter": "`textures`, and `filter.anisotropy` is above 1",
    "perspective": "`inverse_w`, which bends colours or texture coordinates",
    "depth test": "`depth`",
    "pixel shading": "`coverage.shading` is 'pixel', and colours vary within a triangle",
    "soft coverage": "`coverage` is `Soft`",
    "exact area": "`coverage` is `Area`",
    "guard band": "triangles reach past half the longer side around the canvas",
}
"""Each effect of a program, and the reason that it is there."""


def is_translucent(scene: Scene) -> bool:
    """Whether a triangle may let others show through, so that all of them are composited."""
    textures = scene.textures
    return scene.colors.shape[-1] == 4 or (textures is not None and textures.channels == 4)


def varies(scene: Scene) -> bool:
    """Whether the colour of a triangle may differ from point to point."""
    return scene.textures is not None or scene.colors.shape[-2] == 3


def is_shaded(scene: Scene, rate: str) -> bool:
    """Whether colours are evaluated point by point, at `rate` as `Hard.shading`.

    Where they are affine on the screen and taken at each sample, sums of places tell them.
    """
    bent = scene.inverse_w is not None or rate == "pixel"
    return scene.textures is not None or (varies(scene) and bent)


def structural_effects(scene: Scene, coverage: Hard | Soft | Area, filter: Filter) -> set[str]:
    """Names of `EFFECTS`; all but those that only concrete positions tell."""
    textures = scene.textures
    textured = textures is not None
    present = {
        "interpolated colour": scene.colors.shape[-2] == 3,
        "translucency": is_translucent(scene),
        "translucent background": scene.background.shape[-1] == 4,
        "texture": textured,
        "mip levels": textured and textures.depth > 1 and filter.level != "zero",
        "bilinear filter": textured and filter.pixel == "bilinear",
        "anisotropic filter": textured and filter.anisotropy > 1,
        "perspective": scene.inverse_w is not None and varies(scene),
        "depth test": scene.depth is not None,
        "pixel shading": isinstance(coverage, Hard)
        and coverage.shading == "pixel"
        and varies(scene),
        "soft coverage": isinstance(coverage, Soft),
        "exact area": isinstance(coverage, Area),
    }
    return {name for name, here in present.items() if here}


def hiding(scene: Scene, orientation: Any) -> Any:
    """Triangles `[triangles]` through which nothing shows where they are drawn.

    With depth none is known to. For numpy and jax alike.
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
