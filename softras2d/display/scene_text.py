"""Describes a scene on two lines: counts, dtype and extent; then the effects that it needs."""

import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..numerics.device import is_traced
from .leaves import dtype_of, field_of, shape_of, size_of, values_of
from .words import count_text

_REQUIRED = ("positions", "triangles", "colors", "background")
_OPTIONAL = ("uv", "texture_index", "depth", "inverse_w")
_TEXTURE_ARRAYS = ("texels", "levels")


def scene_text(scene: Any) -> str:
    """Describe a scene on two lines; never raises, whatever its leaves are.

    The first line gives the numbers of triangles, vertices and textures, the dtype, and the extent,
    which is the range of the finite vertices that triangles use. The second line gives the effects
    that the scene needs (`_effects`), and the fields that are not arrays but should be. Under a
    trace, no value is looked at.
    """
    # A scene whose constructor failed has some fields only.
    arrays = {name: field_of(scene, name) for name in (*_REQUIRED, *_OPTIONAL)}
    textures = field_of(scene, "textures")
    if textures is not None:
        arrays |= {name: field_of(textures, name) for name in _TEXTURE_ARRAYS}
    counts_and_extent = [*_counts(arrays), dtype_of(arrays["positions"]), _values_text(arrays)]
    not_arrays = [
        f"{name} ({type(value).__name__})"
        for name, value in arrays.items()
        if shape_of(value) is None and not (name in _OPTIONAL and value is None)
    ]
    effects = [*_effects(arrays), f"not arrays: {', '.join(not_arrays)}" if not_arrays else ""]
    return f"{_heading(arrays)}: {_joined(counts_and_extent)}\n  {_joined(effects)}"


def buffers_text(buffers: Any) -> str:
    """Describe a `Visibility` or `PixelLayers` on two lines; never raises, whatever its leaves are.

    They are the results of `rasterize` and `pixel_layers`.

    The first line gives the shape of the buffer `triangle`, the second the counts and the extent of
    the scene.
    """
    shape = list(shape_of(field_of(buffers, "triangle")) or ())
    scene = scene_text(field_of(buffers, "scene")).splitlines()[0]
    return f"{type(buffers).__name__}: triangle {shape}\n  {scene}"


def _joined(phrases: list[str | None]) -> str:
    """Join the phrases that are not empty with commas; `no arrays` if all are empty."""
    return ", ".join(phrase for phrase in phrases if phrase) or "no arrays"


def _heading(arrays: dict[str, Any]) -> str:
    """First words of the description: `Scene`, or for a batch such as `Batch of 3 scenes, each`.

    `arrays`: the leaves of the scene, by the names of their fields.
    """
    for name in ("triangles", "positions"):
        shape = shape_of(arrays[name])
        if shape is not None and len(shape) > 2:
            return f"Batch of {' x '.join(map(str, shape[:-2]))} scenes, each"
    return "Scene"


def _counts(arrays: dict[str, Any]) -> list[str]:
    """Texts of the numbers of triangles, vertices and textures, as far as they are known.

    `arrays`: the leaves of the scene, by the names of their fields.
    """
    triangles = size_of(arrays["triangles"], -2)
    if triangles is None:
        # A gradient has colours but no indices.
        triangles = size_of(arrays["colors"], -3)
    counts = [
        (triangles, "triangle", "triangles"),
        (size_of(arrays["positions"], -2), "vertex", "vertices"),
        (size_of(arrays.get("levels"), -3), "texture", "textures"),
    ]
    return [count_text(*count) for count in counts if count[0] is not None]


def _effects(arrays: dict[str, Any]) -> list[str | None]:
    """Names of the effects that a scene needs whatever the options, as in `effects.EFFECTS`.

    `arrays`: the leaves of the scene, by the names of their fields. The list has an entry for each
    possible effect, which is None if the scene does not need the effect or if this is not known.
    But the first is `flat colour` for a scene without interpolated colours, and the second is
    `opaque` for a scene without translucency.
    """
    corners, channels = size_of(arrays["colors"], -2), size_of(arrays["colors"], -1)
    is_translucent = 4 in (channels, size_of(arrays.get("texels"), -1))
    opacity = "translucency" if is_translucent else "opaque"
    return [
        {1: "flat colour", 3: "interpolated colour"}.get(corners),
        opacity if channels is not None else None,
        "translucent background" if size_of(arrays["background"], -1) == 4 else None,
        "texture" if "levels" in arrays else None,
        "perspective" if arrays["inverse_w"] is not None else None,
        "depth test" if arrays["depth"] is not None else None,
    ]


def _values_text(arrays: dict[str, Any]) -> str:
    """Text of the extent of the triangles, in pixels, or of the reason why there are no values.

    It also says how many of their vertices are not finite. It is empty if `used_points` finds no
    vertices. `arrays`: the leaves of the scene, by the names of their fields.
    """
    if is_traced(arrays):
        return "traced"
    positions, triangles = values_of(arrays["positions"]), values_of(arrays["triangles"])
    if positions is None or triangles is None:
        have_dtypes = dtype_of(arrays["positions"]) and dtype_of(arrays["triangles"])
        return "no values" if have_dtypes else ""
    points = used_points(positions, triangles)
    if points is None or not len(points):
        return ""
    is_finite = np.isfinite(points).all(axis=1)
    count = int(np.count_nonzero(~is_finite))
    invalid = count_text(count, "vertex not finite", "vertices not finite") if count else ""
    if not is_finite.any():
        return invalid
    low, high = extent(points[is_finite])
    ranges = [
        f"{axis} {first:.5g} to {last:.5g} px"
        for axis, first, last in zip("xy", low.tolist(), high.tolist(), strict=True)
    ]
    return ", ".join(filter(None, [*ranges, invalid]))


def used_points(
    positions: np.ndarray, triangles: np.ndarray
) -> Float[np.ndarray, "points 2"] | None:
    """The positions of all vertices that triangles use, in a scene or in a batch of scenes.

    Each vertex appears once, in float64; the vertices of a batch are in one array. Indices out of
    range are ignored. None if the dtypes or shapes are not those of a scene. Other vertices are
    left out because they would enlarge the extent: padding appends vertices at (0, 0).
    """
    has_types = triangles.dtype.kind in "iu" and jnp.issubdtype(positions.dtype, jnp.floating)
    has_axes = min(triangles.ndim, positions.ndim) >= 2 and positions.shape[-1] == 2
    if not (has_types and has_axes) or triangles.shape[:-2] != positions.shape[:-2]:
        return None
    # Sizes are given in full, since `reshape` cannot resolve -1 for arrays without entries.
    scenes, vertices = math.prod(positions.shape[:-2]), positions.shape[-2]
    indices = triangles.reshape(scenes, math.prod(triangles.shape[-2:]))
    is_valid = (indices >= 0) & (indices < vertices)
    is_used = np.zeros((scenes, vertices), bool)
    scene_number, _ = np.nonzero(is_valid)
    is_used[scene_number, indices[is_valid]] = True
    # In float64, differences of the largest numbers of narrower types do not overflow.
    return positions.reshape(scenes, vertices, 2)[is_used].astype(np.float64)


def extent(
    points: Float[np.ndarray, "points 2"],
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """The least (x, y) and the greatest (x, y) of points, each coordinate by itself."""
    # Adding zero turns -0 into 0.
    return points.min(axis=0) + 0.0, points.max(axis=0) + 0.0
