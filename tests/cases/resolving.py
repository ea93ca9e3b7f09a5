"""Images and gradients from `rasterize` and `resolve`, with colours computed by a test."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

import softras2d as sr

from ..oracles.shading import Soup


def scene_shade(visible: sr.Visibility, scene: sr.Scene, filter: sr.Filter) -> Any:
    """A function for `resolve` that returns the colours of an opaque scene, with its textures."""

    def shade(
        triangle: Int[Array, " n"], weights: Float[Array, "n 3"]
    ) -> Float[Array, "n channels"]:
        corners = jnp.broadcast_to(scene.colors, (scene.colors.shape[0], 3, 3))
        color = jnp.einsum("nk,nkc->nc", weights, corners[triangle])
        if scene.uv is None or scene.textures is None or scene.texture_index is None:
            return color
        uv = jnp.einsum("nk,nkc->nc", weights, scene.uv[triangle])
        footprint = visible.footprint(triangle, weights, scene.uv)
        index = scene.texture_index[triangle]
        return color * sr.sample_texture(scene.textures, uv, footprint, filter, texture_index=index)

    return shade


def resolve_scene(scene: sr.Scene, plan: sr.Plan) -> Float[Array, "height width 3"]:
    """The image of an opaque scene by `rasterize` and `resolve`."""
    visible = sr.rasterize(scene, plan)
    return sr.resolve(visible, scene_shade(visible, scene, plan.filter))


def resolve_interpolated(scene: sr.Scene, plan: sr.Plan) -> Float[Array, "height width 3"]:
    """The image by `rasterize` and `resolve`, from an array of interpolated vertex colours."""
    visible = sr.rasterize(scene, plan)
    return sr.resolve(visible, sr.interpolate(visible, scene.colors))


@eqx.filter_jit
def image_and_gradient(
    draw: Any, scene: sr.Scene, plan: sr.Plan, weight: Any
) -> tuple[Float[Array, "height width 3"], sr.Scene]:
    """The image from `draw`, and the gradient of its weighted sum for all floats of the scene."""
    floats, rest = eqx.partition(scene, eqx.is_inexact_array)

    def total(floats: Any) -> tuple[Array, Array]:
        image = draw(eqx.combine(floats, rest), plan)
        return jnp.sum(weight * image), image

    gradient, image = jax.grad(total, has_aux=True)(floats)
    return image, gradient


def random_weight(plan: sr.Plan, channels: int = 3, seed: int = 1) -> Any:
    """A seeded weight for each value of an image."""
    shape = (plan.height, plan.width, channels)
    return jnp.asarray(np.random.default_rng(seed).normal(size=shape), jnp.float32)


def with_slivers(soup: Soup, height: int, width: int) -> Soup:
    """Replace every third triangle by a long one, less than half a pixel thick.

    Half of these cross the canvas, and half run along its border.
    """
    rng = np.random.default_rng(0)
    corners, size = np.array(soup.corners), np.array([width, height])
    for index in range(0, len(corners), 3):
        ends = rng.uniform(-0.1, 1.1, (2, 2)) * size
        if index % 2:
            axis = rng.integers(2)
            ends[:, axis] = rng.choice([0.0, size[axis]])
        apart = rng.uniform(0.03, 0.3) * np.array([1, -1])
        corners[index] = [ends[0], ends[1], ends[1] + apart]
    return replace(soup, corners=corners)


def network(parameters: tuple[Any, Any], features: Any, numpy: Any = jnp) -> Any:
    """A network of two layers, from three features to three values in -1..1.

    `numpy`: the library that computes it, `jax.numpy` or `numpy`.
    """
    first, second = parameters
    return numpy.tanh(numpy.tanh(features @ first) @ second)


def network_parameters(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(3, 6)) * 2, rng.normal(size=(6, 3))
