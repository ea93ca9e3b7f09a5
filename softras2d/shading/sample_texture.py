"""`sample_texture`: the texture filters of the package, for a caller's own shading."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..numerics.device import is_traced, to_host
from ..options import Filter
from ..texture.pyramid import TexturePyramid
from .texture_lookup import LevelsAndProbes, Textures, levels_and_probes_of, probe_point


def sample_texture(
    textures: TexturePyramid,
    uv: Any,
    footprint: Any = None,
    filter: Filter | None = None,
    *,
    texture_index: Any = 0,
) -> Float[Array, "*points channels"]:
    """Read textures at points, filtered as in `render`.

    - `textures`: from `TexturePyramid.build`.
    - `uv`: `[..., 2]`, u right and v down, 0..1 across the image.
    - `footprint`: the change of (u, v) for a step of one pixel along x and along y, `[..., 2, 2]`;
      entry [..., i, j] is the change of coordinate i along axis j (`Visibility.footprint`). It
      decides the mip level and the probes. None reads the base level.
    - `filter`: how textures are filtered; None is `Filter()`.
    - `texture_index`: index of the texture, one integer or an array that broadcasts to `[...]`; -1
      reads 1 in every channel.

    Returns RGB or premultiplied RGBA. Differentiable with respect to `uv`, `footprint` and texels;
    the derivative with respect to the footprint comes from the blend between two levels and from
    the probes.

    Raises `ValueError` for other shapes, for `textures` and `filter` of other types, and for a
    `texture_index` that is no integer or, if it is concrete, outside -1..`textures.count` - 1.
    """
    filter = Filter() if filter is None else filter
    if not isinstance(textures, TexturePyramid):
        kind = type(textures).__name__
        raise ValueError(
            f"`textures` must come from TexturePyramid.build([image, ...]); got {kind}."
        )
    if not isinstance(filter, Filter):
        raise ValueError(f"`filter` must be Filter(...); got {filter!r}.")
    uv = jnp.asarray(uv)
    if uv.shape[-1:] != (2,):
        raise ValueError(f"`uv` must be [..., 2]; got {uv.shape}.")
    if footprint is None:
        footprint = jnp.zeros((*uv.shape, 2), uv.dtype)
    footprint = jnp.asarray(footprint)
    if footprint.shape != (*uv.shape, 2):
        raise ValueError(
            f"`footprint` must be [..., 2, 2] like `uv`, {(*uv.shape, 2)}; got {footprint.shape}."
        )
    points = uv.reshape(-1, 2).T
    along_x, along_y = jnp.moveaxis(footprint.reshape(-1, 2, 2), 0, -1).swapaxes(0, 1)
    index = _checked_index(texture_index, textures, uv.shape[:-1]).reshape(-1)
    collected = Textures.of(textures, filter)
    assert collected is not None
    chosen = levels_and_probes_of(collected, index, along_x, along_y)
    texel = _sum_probes(collected, points, chosen)
    texel = jnp.where((index < 0)[None], 1.0, texel)
    return texel.T.reshape(*uv.shape[:-1], textures.channels)


def _checked_index(
    texture_index: Any, textures: TexturePyramid, shape: tuple[int, ...]
) -> Int[Array, "*points"]:
    """Return one texture index for each point, where the points have the shape `shape`.

    Raises `ValueError` for an index that is no integer, does not broadcast to `shape`, or is out of
    range. The range of traced indices is not checked.
    """
    index = to_host(texture_index)
    if not jnp.issubdtype(index.dtype, jnp.integer):
        raise ValueError(f"`texture_index` must be integers; got {index.dtype}.")
    try:
        fits = np.broadcast_shapes(index.shape, shape) == shape
    except ValueError:
        fits = False
    if not fits:
        raise ValueError(
            f"`texture_index` must be one integer or like the points of `uv`, {shape}; got "
            f"{index.shape}."
        )
    last = textures.count - 1
    if not is_traced(index) and index.size and not -1 <= index.min() <= index.max() <= last:
        raise ValueError(
            f"`texture_index` must be in -1..{last}; got {index.min()}..{index.max()}."
        )
    return jnp.broadcast_to(jnp.asarray(index, jnp.int32), shape)


def _sum_probes(
    textures: Textures, uv: Float[Array, "2 points"], chosen: LevelsAndProbes
) -> Float[Array, "channels points"]:
    """Mean of the texels that the probes of each point read, as RGB or premultiplied RGBA.

    A probe is one of several reads, spread over the footprint of a pixel. `chosen` has the mip
    levels and the probes of each point, and `uv` the point in the middle of its probes.
    """

    def add_probe(total: Array, probe: Array) -> tuple[Array, None]:
        at, share = probe_point(uv, chosen, probe)
        texel = textures.read(chosen.levels, at).T[: textures.channels]
        return total + (texel if share is None else texel * share[None]), None

    probes = jnp.arange(textures.filter.anisotropy, dtype=jnp.int32)
    zeros = jnp.zeros((textures.channels, uv.shape[1]), textures.texels.dtype)
    return jax.lax.scan(jax.checkpoint(add_probe), zeros, probes)[0]
