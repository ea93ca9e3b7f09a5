"""`rasterize`: find the triangle that shows at each sample, and interpolate attributes there."""

import functools
from typing import Any, SupportsIndex

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..display.notebook import buffers_html
from ..display.scene_text import buffers_text
from ..gradients.crossings import Sample
from ..gradients.visible_front import triangle_at
from ..numerics.arguments import checked_integer
from ..planning.capacities import Needs
from ..planning.plan import Plan
from ..planning.size_classes import pad_concrete
from ..scene import Scene, check_types
from .arguments import check_scene_and_plan
from .corner_weights import buffer_weights, uv_change, with_unit_corners
from .listed_samples import ListedSamples, count_covering, nearest_layers
from .overflow import Outcome, compare, nan_on_overflow, raise_on_overflow
from .pixel_layers import PixelLayers
from .projected_scene import project_scene
from .sample_grid import map_over_rows, samples_of_rows
from .visible_samples import bin_scene, find_visible, listed_words

MOST_BYTES = 2**31
"""Largest size of the triangle indices that `rasterize` returns, in bytes."""


class Visibility(eqx.Module):
    """Visibility buffers: the triangle that shows at each sample of a scene, made by `rasterize`.

    Only `triangle` is stored. The other buffers are computed from it and from the scene whenever
    they are read; `barycentric` and `depth` are differentiable with respect to the scene. If
    `rasterize` was called with more than one layer, every buffer except `coverage` and `overdraw`
    has an axis of layers after the samples, `[height, width, samples, layers, ...]`, nearest layer
    first.

    With S * S samples per pixel, sample i lies in sub-column i % S and sub-row i // S. The buffers
    of a batch, which `jax.vmap` returns, can be read under `jax.vmap` only, except `triangle`.

    - `triangle`: index of the triangle that shows, -1 for background or an unused layer.
    - `scene`, `plan`: the arguments of `rasterize`.
    - `overflow`: whether the scene outgrew the plan, so that buffers or derivatives are wrong.
    """

    triangle: Int[Array, "height width samples *layers"]
    scene: Scene
    plan: Plan
    overflow: Bool[Array, ""]

    def __repr__(self) -> str:
        return buffers_text(self)

    def _repr_html_(self) -> str | None:
        """HTML of a picture with one colour per triangle, above the text of `repr`.

        Returns None for several layers, for a batch and for traced buffers.
        """
        return buffers_html(self, repr(self))

    @property
    def barycentric(self) -> Float[Array, "height width samples *layers 3"]:
        """Barycentric weights of the corners of the triangle at each sample; 0 for background.

        The weights are in the order of `scene.triangles`, and sum to 1. They are
        perspective-correct if the scene has `inverse_w`. They are taken at the sample or, with
        `Hard(shading="pixel")`, at the one point of the pixel where `render` shades the triangle.
        Their derivative with respect to positions is taken at a fixed point of the screen, and does
        not include edges that move over samples. It is zero with `Hard(edge_gradients=False)`.
        """
        return self._checked(_weights(self, perspective=True))

    @property
    def depth(self) -> Float[Array, "height width samples *layers"] | None:
        """Depth of the triangle at each sample, infinity for background.

        It is taken at the same point as `barycentric`: with `Hard(shading="pixel")` it is not the
        depth at the sample, which the depth test compares. None if the scene has no depth.
        """
        if self.scene.depth is None:
            return None
        corner_depth = self.scene.depth[self.scene.triangles]
        weights = _weights(self, perspective=False)
        depth = _interpolate(weights, self.triangle, corner_depth[..., None])[..., 0]
        return self._checked(jnp.where(self.triangle < 0, jnp.inf, depth))

    @property
    def coverage(self) -> Float[Array, "height width"]:
        """Fraction, 0..1, of the samples of each pixel that some triangle covers.

        It has no derivative.
        """
        refuse_batch(self)
        first = self.triangle if self.triangle.ndim == 3 else self.triangle[..., 0]
        share = jnp.mean((first >= 0).astype(self.scene.positions.dtype), axis=-1)
        return self._checked(share)

    @property
    def overdraw(self) -> Int[Array, "height width samples"]:
        """Number of triangles that cover each sample, including hidden ones.

        It is -1 everywhere if the scene outgrew the plan. If the argument `layers` of `rasterize`
        is the largest value of `overdraw` or more, no triangle is left out for lack of layers.
        """
        refuse_batch(self)
        count = _count_covering(pad_concrete(self.scene, self.plan), self.plan)
        return jnp.where(self.overflow, -1, count)

    def _checked(self, buffer: Array) -> Array:
        """Return the buffer, or NaN with NaN derivatives if the scene outgrew the plan."""
        return nan_on_overflow(buffer, self.scene, self.overflow)

    def footprint(
        self, triangle: Int[Array, "*n"], barycentric: Float[Array, "*n 3"], uv: Any
    ) -> Float[Array, "*n 2 2"]:
        """Change of interpolated (u, v) for a step of one pixel, for `sample_texture`.

        - `triangle`, `barycentric`: the triangle and corner weights of each point, as `resolve`
          passes them to a function, or as they are in the buffers of this object.
        - `uv`: texture coordinates of vertices `[vertices, 2]`, or of corners `[triangles, 3, 2]`.

        Entry [..., i, j] of the result is the change of coordinate i (u, v) along axis j (x, y). It
        is the same at all points of a triangle unless the scene has `inverse_w`, and has no meaning
        where `triangle` is -1. Raises `ValueError` for other shapes of `uv`.
        """
        corners = _at_corners(self, "uv", uv, channels=2)
        if corners.shape[0] == 0:
            return jnp.zeros((*triangle.shape, 2, 2), corners.dtype)
        change = uv_change(
            self.scene, self.plan, triangle.reshape(-1), barycentric.reshape(-1, 3), corners
        )
        return change.reshape(*triangle.shape, 2, 2)


def rasterize(scene: Scene, plan: Plan, *, layers: SupportsIndex = 1) -> Visibility:
    """Find the triangle that shows at each sample, or the nearest few.

    - `plan`: for `Hard` coverage; `pixel_layers` is for `Soft` and `Area`.
    - `layers`: how many triangles to keep at each sample, nearest first: in reverse draw order, and
      with depth only triangles that pass the depth test when they are drawn. Alpha does not matter:
      one layer has the nearest triangle even if that is transparent, and with more layers an opaque
      triangle does not hide those behind it. One layer costs least.

    `rasterize` is pure: use it under `jit` and `vmap`. The indices, `coverage` and `overdraw` have
    no derivative. `barycentric`, `depth`, `interpolate` and `resolve` are differentiable with
    respect to all floats of the scene on which they depend.
    A scene that outgrows its plan raises an error as in `render`. If `plan.on_overflow` is `"nan"`,
    a compiled program raises none: images of `resolve` and `composite`, all buffers of floats, and
    their derivatives are then NaN, and `overdraw` is -1.

    Raises `ValueError` for a plan with `Soft` or `Area` coverage, for a batch of scenes, for
    `layers` that is not an integer of 1 or more, and for indices of more than 2 GiB: then draw the
    canvas in windows (`plan(origin=...)`).
    """
    check_scene_and_plan(scene, plan)
    # The number of layers decides the shape of the buffers, so it is known while tracing.
    layers = checked_integer("layers", layers, 1)
    _check(plan, layers)
    triangle, outcome = _find_triangles(pad_concrete(scene, plan), plan, layers)
    return Visibility(triangle, scene, plan, raise_on_overflow(outcome, plan))


def interpolate(
    visible: Visibility, attributes: Any
) -> Float[Array, "height width samples *layers channels"]:
    """Interpolate attributes of vertices or of corners at each sample; 0 for background.

    `attributes` are `[vertices, channels]`, or `[triangles, 3, channels]` in the order of
    `scene.triangles`. The weights are `visible.barycentric`, which says at which point they are
    taken; so interpolation is perspective-correct if the scene has `inverse_w`. The result is
    differentiable with respect to the attributes, and to the scene's positions and `inverse_w`.
    Raises `ValueError` for other shapes, and for the buffers of a batch.
    """
    corners = _at_corners(visible, "attributes", attributes)
    return _interpolate(visible.barycentric, visible.triangle, corners)


def refuse_batch(visible: Visibility | PixelLayers) -> None:
    """Raise `ValueError` for the buffers of a batch, which `jax.vmap` returns.

    An axis of scenes would be taken for an axis of the canvas, or for the axis of layers.
    """
    if visible.scene.positions.ndim != 2:
        raise ValueError(
            "these are buffers of a batch of scenes: use them under jax.vmap, as in "
            "jax.vmap(lambda visible: visible.coverage)(batch)."
        )


def _at_corners(
    visible: Visibility, name: str, values: Any, channels: int | None = None
) -> Float[Array, "triangles 3 channels"]:
    """Return values of vertices or of corners as values of corners.

    Raises `ValueError`, naming the argument `name`, unless `values` is `[vertices, channels]` or
    `[triangles, 3, channels]`. If `channels` is None, any number is accepted. Also raises it for
    the buffers of a batch.
    """
    refuse_batch(visible)
    corners, scene = jnp.asarray(values), visible.scene
    if corners.ndim == 2 and corners.shape[0] == scene.positions.shape[0]:
        corners = corners[scene.triangles]
    is_wrong = corners.ndim != 3 or corners.shape[:2] != scene.triangles.shape
    if is_wrong or channels not in (None, corners.shape[2]):
        vertices, triangles = scene.positions.shape[0], scene.triangles.shape[0]
        last = "channels" if channels is None else channels
        raise ValueError(
            f"`{name}` must be [{vertices} vertices, {last}] or [{triangles} triangles, 3, "
            f"{last}]; got {tuple(jnp.shape(values))}."
        )
    return corners


def _interpolate(
    weights: Float[Array, "*samples 3"],
    triangle: Int[Array, "*samples"],
    corners: Float[Array, "triangles 3 channels"],
) -> Float[Array, "*samples channels"]:
    """Interpolate between the values at the corners of each sample's triangle; 0 for triangle -1.

    If the three values are equal, the result is exactly the same value.
    """
    if corners.shape[0] == 0:
        return jnp.zeros((*triangle.shape, corners.shape[2]), corners.dtype)
    first, second, third = (corners[:, k][jnp.maximum(triangle, 0)] for k in range(3))
    value = first + weights[..., 1:2] * (second - first) + weights[..., 2:3] * (third - first)
    return jnp.where((triangle < 0)[..., None], 0.0, value)


def _check(plan: Plan, layers: int) -> None:
    """Check the arguments of `rasterize`; raise `ValueError` for those that it does not take.

    These are plans for other coverage than `Hard`, and indices of more than `MOST_BYTES`.
    """
    if plan.side:
        raise ValueError(
            f"`rasterize` needs a plan for Hard(...), and `pixel_layers` one for Soft(...) or "
            f"Area(...); got {plan.coverage!r}."
        )
    size = plan.buffer_memory * layers
    if size > MOST_BYTES:
        raise ValueError(
            f"the triangle indices would take {size:,} bytes, more than {MOST_BYTES:,}: draw the "
            "canvas in windows, with `origin`, or use fewer samples or layers."
        )


@eqx.filter_jit
def _find_triangles(scene: Scene, plan: Plan, layers: int) -> tuple[Array, Outcome]:
    """Find the index of the triangle at each sample, and whether the plan was large enough.

    Arguments are as in `rasterize`. The indices are laid out as `Visibility.triangle`, without an
    axis of layers if `layers` is 1.
    """
    if scene.positions.ndim != 2:
        raise ValueError("`rasterize` takes one scene: use jax.vmap for a batched one.")
    check_types(scene)
    grid = plan.grid
    shape = (grid.height, grid.width, grid.samples, *((layers,) if layers > 1 else ()))
    if scene.triangles.shape[0] == 0:
        return jnp.full(shape, -1, jnp.int32), compare(Needs(), False, plan)
    scene = jax.lax.stop_gradient(scene)
    if layers == 1:
        # Opaque colours do not change which triangle is nearest, but triangles that are hidden in a
        # whole tile are then not listed.
        scene = with_unit_corners(scene)
    binned = bin_scene(scene, plan, list_hidden=layers > 1)
    needs = binned.needs
    if layers == 1:
        visible = find_visible(binned, scene, plan)
        chunks = visible.front.chunks
        needs = needs._replace(chunks=chunks.needed, max_chunks=chunks.most_in_tile)
        max_chunks = plan.capacity_of(scene.triangles.shape[0]).max_chunks
        look = functools.partial(
            triangle_at, visible.front, tiling=plan.tiling, max_chunks=max_chunks
        )
    else:
        passed = listed_words(binned, plan)[1]
        look = functools.partial(
            nearest_layers, ListedSamples(binned.lists, passed), tiling=plan.tiling, layers=layers
        )
    outcome = compare(needs, binned.projected.leaves_guard_band, plan)
    return map_over_rows(look, grid).reshape(shape), outcome


@eqx.filter_jit
def _count_covering(scene: Scene, plan: Plan) -> Int[Array, "height width samples"]:
    """Number of triangles that cover each sample, including those that fail the depth test."""
    grid = plan.grid
    shape = (grid.height, grid.width, grid.samples)
    if scene.triangles.shape[0] == 0:
        return jnp.zeros(shape, jnp.int32)
    binned = bin_scene(jax.lax.stop_gradient(scene), plan, list_hidden=True)
    covered = listed_words(binned, plan)[0]
    look = functools.partial(
        count_covering, ListedSamples(binned.lists, covered), tiling=plan.tiling
    )
    return map_over_rows(look, grid).reshape(shape)


def _weights(visible: Visibility, *, perspective: bool) -> Array:
    """Barycentric weights of the corners of the triangle at every sample, 0 for background.

    They are taken at the point of `Visibility.barycentric`. The last axis has the three corners. If
    `perspective` is false, the weights are affine on the screen even if the scene has `inverse_w`.
    """
    refuse_batch(visible)
    scene, plan, triangle = visible.scene, visible.plan, visible.triangle
    grid = plan.grid
    if scene.triangles.shape[0] == 0:
        return jnp.zeros((*triangle.shape, 3), scene.positions.dtype)
    projected = project_scene(with_unit_corners(scene, perspective=perspective), plan)
    sample = samples_of_rows(jnp.zeros((), jnp.int32), grid.height, grid)
    if triangle.ndim == 4:
        sample = Sample(*(jnp.repeat(entry, triangle.shape[3], 1) for entry in sample))
    weights = buffer_weights(projected, triangle.reshape(grid.height, -1), sample, plan)
    return jnp.moveaxis(weights, 0, -1).reshape(*triangle.shape, 3)
