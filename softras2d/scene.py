"""The scene, which is a list of triangles in draw order, and the conventions of the package.

- **Coordinates** are pixels, x right and y down; pixel (row r, column c) is the square
  [c, c+1) x [r, r+1), with its centre at +0.5.
- **Images** are `[height, width, channels]` in 0..1. Public functions take and return straight
  alpha; compositing uses premultiplied alpha. Colours are averaged as the scene holds them: a
  render never converts them between sRGB and linear light.
- **Colours outside 0..1** are drawn without clipping, because interpolation, blending and averaging
  are linear. Writers of 8-bit images clip them; EXR and SVG keep them. `check` refuses alpha
  outside 0..1.
- **Draw order**: later triangles lie in front. With `depth`, which grows away from the viewer, the
  nearest triangle wins under `Hard`, and of equal depths the later one. With translucency too, a
  triangle that is drawn later but lies behind is hidden even by a translucent one.
- **Textures**: the colour and alpha of a textured sample are the filtered texel times the
  interpolated colour and alpha of the triangle.
- **Barycentric weights** of the corners 0, 1 and 2 sum to one.
- **Texture space**: u right and v down, 0..1 across the image.
"""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int

from .display.notebook import scene_html
from .display.scene_text import scene_text
from .numerics.arguments import check_type
from .numerics.byte_colors import refuse_integer_bytes, warn_of_bytes
from .numerics.device import is_traced, to_device, to_host
from .texture.pyramid import TexturePyramid


class Scene(eqx.Module):
    """Triangles over a background. The optional arrays decide which effects are drawn.

    - `positions`: `(x, y)` in pixels, x right and y down.
    - `triangles`: three vertex indices each, in draw order and in either orientation; triangles may
      share vertices.
    - `colors`: straight RGB (opaque) or RGBA. With one corner each triangle has one colour; the
      colours of three corners are interpolated. Black is 0 and white is 1; values outside 0..1 are
      drawn without clipping.
    - `background`: RGB (opaque) or straight RGBA.
    - `uv`, `texture_index` (-1: none), `textures`: texture coordinates of each corner, the texture
      of each triangle, and the pyramid of all textures. Give all three or none.
    - `depth`: one value per vertex, which grows away from the viewer and is interpolated affinely
      on the screen, as z/w is. Under `Hard` a triangle is left out where it lies deeper than one
      drawn there before; `Soft` mixes by depth; `Area` refuses it. If None, draw order decides.
    - `inverse_w`: 1/w of the projection for each vertex, positive. With it, colours and `uv` are
      interpolated in perspective; without it, affinely on the screen.

    A batch of scenes has a leading axis on every array, for `jax.vmap`.
    """

    positions: Float[Array, "vertices 2"]
    triangles: Int[Array, "triangles 3"]
    colors: Float[Array, "triangles corners channels"]
    background: Float[Array, " background_channels"]
    uv: Float[Array, "triangles 3 2"] | None = None
    texture_index: Int[Array, " triangles"] | None = None
    textures: TexturePyramid | None = None
    depth: Float[Array, " vertices"] | None = None
    inverse_w: Float[Array, " vertices"] | None = None

    def __check_init__(self):
        corners, channels = self.colors.shape[-2:]
        if corners not in (1, 3) or channels not in (3, 4):
            raise ValueError(
                "`colors` must be [triangles, 1 or 3 corners, 3 or 4 channels]; "
                f"got {self.colors.shape}."
            )
        if self.background.shape[-1] not in (3, 4):
            raise ValueError(f"`background` must be [3] or [4]; got {self.background.shape}.")
        if len({self.uv is None, self.texture_index is None, self.textures is None}) != 1:
            raise ValueError("`uv`, `texture_index` and `textures` go together: give all or none.")

    def __repr__(self) -> str:
        return scene_text(self)

    def _repr_html_(self) -> str | None:
        """Return HTML of a small picture above the text of `repr`; None if it cannot be drawn."""
        return scene_html(self)

    @staticmethod
    def from_mesh(
        positions: Any,
        triangles: Any,
        *,
        vertex_colors: Any = None,
        triangle_colors: Any = None,
        background: Any = None,
        uv: Any = None,
        texture_index: Any = None,
        textures: TexturePyramid | None = None,
        depth: Any = None,
        inverse_w: Any = None,
    ) -> "Scene":
        """Make a scene whose triangles share vertices.

        Give either `vertex_colors` `[vertices, channels]`, or `triangle_colors` `[triangles,
        channels]` (flat) or `[triangles, 3, channels]` (one per corner). The other arguments are
        the fields of `Scene`. The default `background` is opaque white. All floats get the dtype of
        `positions`, which is float32 or, with `jax_enable_x64`, float64; integer positions become
        float32. Arrays on the host are converted without compiling anything.

        Raises `ValueError` for invalid shapes, dtypes, indices and values; while tracing, `check`
        looks at dtypes only. Warns of colours that look like bytes (0..255).
        """
        given_positions, positions = positions, _floats("positions", positions, None)
        _expect("positions", positions, ("vertices", 2))
        vertices, dtype = positions.shape[0], positions.dtype
        given_triangles, triangles = triangles, _integers("triangles", triangles)
        # An empty list such as `[]` has no second axis.
        triangles = triangles.reshape(-1, 3) if triangles.size == 0 else triangles
        _expect("triangles", triangles, ("triangles", 3))
        # Checked before the cast to int32, in which 2^32 + k becomes k.
        _check_indices(triangles, vertices)
        count = triangles.shape[0]
        if (vertex_colors is None) == (triangle_colors is None):
            raise ValueError("give one of `vertex_colors` and `triangle_colors`.")
        if vertex_colors is not None:
            name, given = "vertex_colors", vertex_colors
            colors = _colors(name, vertex_colors, dtype)
            _expect(name, colors, (vertices, "3 or 4 channels"))
            colors = _gather(colors, triangles)
        else:
            name, given = "triangle_colors", triangle_colors
            colors = _colors(name, triangle_colors, dtype)
            colors = colors[:, None] if colors.ndim == 2 else colors
            _expect(name, colors, (count, "1 or 3 corners", "3 or 4 channels"))
        textures = _textures(textures, dtype)
        if texture_index is not None and textures is not None:
            _check_texture_index(_integers("texture_index", texture_index), textures)
        background = _background(background, dtype)
        scene = Scene(
            positions=_on_device(given_positions, positions),
            triangles=_on_device(given_triangles, triangles, jnp.int32),
            colors=_on_device(given, colors),
            background=to_device(background),
            uv=_optional("uv", uv, dtype, (count, 3, 2)),
            texture_index=_optional("texture_index", texture_index, None, (count,)),
            textures=textures,
            depth=_optional("depth", depth, dtype, (vertices,)),
            inverse_w=_optional("inverse_w", inverse_w, dtype, (vertices,)),
        )
        check(scene)
        warn_of_bytes({f"`{name}`": colors, "`background`": background})
        return scene

    @staticmethod
    def from_soup(corners: Any, colors: Any, **optional: Any) -> "Scene":
        """Make a scene of triangles that share no vertices.

        `corners` is `[triangles, 3, 2]`; `colors` is `[triangles, channels]` (flat) or
        `[triangles, 3, channels]` (one per corner). `optional` are the keywords of `from_mesh` from
        `background` on, but `depth` and `inverse_w` may also be `[triangles, 3]`.
        """
        corners = _floats("corners", corners, None)
        corners = corners.reshape(0, 3, 2) if corners.size == 0 else corners
        _expect("corners", corners, ("triangles", 3, 2))
        count = corners.shape[0]
        colors = _colors("colors", colors, corners.dtype)
        if count == 0:
            colors = colors.reshape(0, *(colors.shape[1:] if colors.ndim > 1 else (3,)))
        colors = colors[:, None] if colors.ndim == 2 else colors
        _expect("colors", colors, (count, "1 or 3 corners", "3 or 4 channels"))
        for name in ("depth", "inverse_w"):
            if optional.get(name) is not None:
                value = _floats(name, optional[name], corners.dtype)
                optional[name] = value.reshape(-1) if value.shape == (count, 3) else value
        return Scene.from_mesh(
            corners.reshape(-1, 2),
            np.arange(3 * count, dtype=np.int32).reshape(-1, 3),
            triangle_colors=colors,
            **optional,
        )


_FLOATING = {"positions": "vertex", "depth": "vertex", "inverse_w": "vertex"}
_FLOATING |= {"uv": "triangle", "colors": "triangle", "background": "channel"}
"""Fields that are arrays of floats, and what the first axis of each counts in a single scene."""


def check_types(scene: Scene) -> None:
    """Raise `ValueError` unless `scene` is a `Scene` of float32 or float64, with integer indices.

    Dtypes are known while tracing too, so they are also checked there. Half precision can represent
    neither the sample grid nor the sums over a triangle's pixels. Integer colours would be
    interpreted as values in 0..1.
    """
    check_type("scene", scene, Scene)
    arrays = {name: getattr(scene, name) for name in _FLOATING}
    indices = {"triangles": scene.triangles, "texture_index": scene.texture_index}
    if scene.textures is not None:
        arrays["texels"] = scene.textures.texels
        indices["levels"] = scene.textures.levels
    for name, value in arrays.items():
        if value is not None and value.dtype not in (np.float32, np.float64):
            raise ValueError(f"`{name}` must be float32 or float64; got {value.dtype}.")
    for name, value in indices.items():
        if value is not None and not jnp.issubdtype(value.dtype, jnp.integer):
            raise ValueError(f"`{name}` must be integers; got {value.dtype}.")


def check(scene: Scene) -> None:
    """Raise `ValueError` for invalid values or dtypes, in one line that names the array.

    Invalid values are NaN, infinity, alpha outside 0..1, an index out of range and `inverse_w` of 0
    or less; the line gives the first of them. Floats must be float32 or float64, and indices
    integers. If any array is traced, only dtypes are checked. Accepts a batch of scenes.
    """
    check_types(scene)
    if is_traced(scene):
        return
    batched = scene.positions.ndim == 3
    _check_indices(scene.triangles, scene.positions.shape[-2])
    for name, axis in _FLOATING.items():
        value = getattr(scene, name)
        if value is not None:
            _refuse(~np.isfinite(value), name, axis, "finite", value, batched)
    if scene.inverse_w is not None:
        inverse_w = np.asarray(scene.inverse_w)
        _refuse(inverse_w <= 0, "inverse_w", "vertex", "positive", inverse_w, batched)
    for name in ("colors", "background"):
        value = np.asarray(getattr(scene, name))
        if value.shape[-1] == 4:
            alpha, axis = value[..., 3], _FLOATING[name]
            _refuse((alpha < 0) | (alpha > 1), f"{name} alpha", axis, "in 0..1", alpha, batched)
    if scene.textures is not None:
        _check_texture_index(scene.texture_index, scene.textures)
        texels = scene.textures.texels
        _refuse(~np.isfinite(texels), "texels", "texel", "finite", texels, batched)
        alpha = np.asarray(texels)[..., 3:]
        _refuse((alpha < 0) | (alpha > 1), "texels alpha", "texel", "in 0..1", alpha, batched)


def _refuse(is_invalid: Any, name: str, axis: str, rule: str, value: Any, batched: bool) -> None:
    """Raise `ValueError` if an entry of `is_invalid` is true, naming the first of these entries.

    The message says that the array `name` must be `rule`. `value` and the host array `is_invalid`
    have one shape: the first axis counts scenes if `batched`, and the next counts what `axis` says.
    """
    if is_invalid.any():
        index = tuple(int(i) for i in np.argwhere(is_invalid)[0])
        labels = [f"scene {index[0]}"] if batched else []
        rest = index[len(labels) :]
        labels += [f"{axis} {rest[0] if len(rest) == 1 else rest}"] if rest else []
        entry = f"{', '.join(labels)} has" if labels else "got"
        raise ValueError(f"`{name}` must be {rule}; {entry} {np.asarray(value)[index]}.")


def _check_indices(triangles: Any, vertices: int) -> None:
    """Raise `ValueError` for an index outside 0..`vertices` - 1; traced indices are not checked."""
    if isinstance(triangles, Tracer):
        return
    index = np.asarray(triangles)
    is_invalid, batched = (index < 0) | (index >= vertices), index.ndim == 3
    _refuse(is_invalid, "triangles", "triangle", f"in 0..{vertices - 1}", index, batched)


def _check_texture_index(texture_index: Any, textures: TexturePyramid) -> None:
    """Raise `ValueError` for indices outside -1..`textures.count` - 1, unless traced."""
    if isinstance(texture_index, Tracer):
        return
    index, last = np.asarray(texture_index), textures.count - 1
    is_invalid, batched = (index < -1) | (index > last), index.ndim == 2
    _refuse(is_invalid, "texture_index", "triangle", f"in -1..{last}", index, batched)


def _expect(name: str, value: Any, expected: tuple[int | str, ...]) -> None:
    """Raise `ValueError` unless the shape of an array is `expected`.

    An axis is a number, a choice such as "3 or 4 channels", or a name, which allows any size.
    """
    choices = [[int(word) for word in str(axis).split() if word.isdigit()] for axis in expected]
    fits = len(value.shape) == len(expected) and all(
        not allowed or size in allowed for size, allowed in zip(value.shape, choices, strict=True)
    )
    if not fits:
        shape = ", ".join(map(str, expected))
        raise ValueError(f"`{name}` must be [{shape}]; got shape {tuple(value.shape)}.")


def _gather(colors: Any, triangles: Any) -> Any:
    """Gather vertex colours `[vertices, channels]` at corners, as `[triangles, 3, channels]`."""
    if isinstance(triangles, Tracer):
        colors = to_device(colors)
    return colors[triangles]


def _on_device(given: Any, prepared: Any, dtype: Any = None) -> Array:
    """Convert `prepared` to a JAX array of `dtype`, or of its own dtype if `dtype` is None.

    `prepared` was made from the caller's value `given`. If `given` is itself a JAX array of the
    same shape, it is converted instead, so that nothing is copied from the host.
    """
    if isinstance(given, jax.Array) and given.shape == prepared.shape:
        return to_device(given, dtype or prepared.dtype)
    return to_device(prepared, dtype)


def _background(value: Any, dtype: Any) -> Any:
    """Check a background colour `[3]` or `[4]`, and convert it to `dtype`; None is opaque white."""
    if value is None:
        return np.ones(3, dtype)
    background = _colors("background", value, dtype)
    _expect("background", background, ("3 or 4 channels",))
    return background


def _textures(value: Any, dtype: Any) -> TexturePyramid | None:
    """Check that a value is a texture pyramid or None, and convert its texels to `dtype`."""
    if value is None:
        return None
    if not isinstance(value, TexturePyramid):
        kind = type(value).__name__
        raise ValueError(
            f"`textures` must come from TexturePyramid.build([image, ...]); got {kind}."
        )
    if value.texels.dtype == dtype:
        return value
    return replace(value, texels=to_device(value.texels, dtype))


def _optional(name: str, value: Any, dtype: Any, shape: tuple[int, ...]) -> Array | None:
    """Convert an array to `dtype` (None: int32) and check its shape; a value of None stays None."""
    if value is None:
        return None
    array = _integers(name, value) if dtype is None else _floats(name, value, dtype)
    _expect(name, array, shape)
    return _on_device(value, array, dtype or jnp.int32)


def _integers(name: str, value: Any) -> Any:
    """Convert as `_numbers` does; raise `ValueError` for a dtype of non-integers, unless empty."""
    array = _numbers(name, value)
    if array.size and not jnp.issubdtype(array.dtype, jnp.integer):
        raise ValueError(f"`{name}` must be integers; got {array.dtype}.")
    return array


def _colors(name: str, value: Any, dtype: Any) -> Any:
    """Convert colours as `_floats` does, but refuse integers as `refuse_integer_bytes` does."""
    array = _numbers(name, value)
    refuse_integer_bytes(f"`{name}`", array)
    return _floats(name, array, dtype)


def _floats(name: str, value: Any, dtype: Any) -> Any:
    """Convert a value to an array of floats of `dtype`, on the host or traced.

    If `dtype` is None: floats keep their dtype, but float64 becomes float32 without
    `jax_enable_x64`; integers and bools become float32; half precision raises `ValueError`.
    """
    array = _numbers(name, value)
    if dtype is None:
        floating = jnp.issubdtype(array.dtype, jnp.floating)
        dtype = jax.dtypes.canonicalize_dtype(array.dtype if floating else np.float32)
        if dtype not in (np.float32, np.float64):
            raise ValueError(f"`{name}` must be float32 or float64; got {dtype}.")
    # Values too large for float32 become infinite, which `check` refuses by name.
    with np.errstate(over="ignore"):
        return array.astype(dtype)


def _numbers(name: str, value: Any) -> Any:
    """Convert a value to a host or traced array of real numbers or bools, or raise `ValueError`."""
    try:
        array = to_host(value)
    except (TypeError, ValueError) as error:
        raise ValueError(f"`{name}` must be numbers in equal rows; got {value!r:.60}.") from error
    if jnp.issubdtype(array.dtype, jnp.complexfloating):
        raise ValueError(f"`{name}` must be real; got {array.dtype}.")
    if array.dtype != bool and not jnp.issubdtype(array.dtype, jnp.number):
        raise ValueError(f"`{name}` must be numbers in equal rows; got {value!r:.60}.")
    return array


def take_triangles(scene: Scene, is_taken: np.ndarray) -> Scene:
    """Return a scene of only the triangles where `is_taken`, `[triangles]`, is true.

    All vertices are kept. Returns `scene` itself if all are taken. Not for use while tracing.
    """
    if is_taken.all():
        return scene

    def gather(value: Array | None) -> Array | None:
        return None if value is None else to_device(np.asarray(value)[is_taken])

    return replace(
        scene,
        triangles=gather(scene.triangles),
        colors=gather(scene.colors),
        uv=gather(scene.uv),
        texture_index=gather(scene.texture_index),
    )
