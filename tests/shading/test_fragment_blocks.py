"""Shading a canvas in several blocks of fragments gives the images and gradients of its windows.

A window has so few fragments that they are shaded at once. Derivatives with respect to texels are
compared too, which have blocks of another size.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d.names import Shading
from softras2d.shading.fragments import FRAGMENTS_PER_BLOCK

pytestmark = pytest.mark.slow

HEIGHT, WIDTH, COUNT = 224, 256, 40
ORIGINS = [(x, y) for y in (0, HEIGHT // 2) for x in (0, WIDTH // 2)]


def _scene(*, perspective: bool) -> sr.Scene:
    """Random textured triangles, of which the first two cover most of the canvas."""
    rng = np.random.default_rng(0)
    corners = rng.uniform(-20, 280, (COUNT, 3, 2))
    corners[:2] = [[[0, 0], [256, 0], [0, 224]], [[256, 0], [256, 224], [0, 224]]]
    return sr.Scene.from_soup(
        corners.astype(np.float32),
        rng.random((COUNT, 3, 3)).astype(np.float32),
        uv=rng.uniform(0, 3, (COUNT, 3, 2)).astype(np.float32),
        texture_index=np.zeros(COUNT, np.int32),
        textures=sr.TexturePyramid.build([rng.random((32, 32, 3)).astype(np.float32)]),
        inverse_w=rng.uniform(0.5, 1, (COUNT, 3)).astype(np.float32) if perspective else None,
    )


def _plan(scene: sr.Scene, shading: Shading, origin: tuple[int, int] | None) -> sr.Plan:
    """Plan the canvas, or the window at `origin`."""
    # Gradients with respect to positions contain crossings at the border of a window.
    hard = sr.Hard(samples=4, shading=shading, edge_gradients=False)
    height, width = (HEIGHT, WIDTH) if origin is None else (HEIGHT // 2, WIDTH // 2)
    return sr.plan(
        scene, height=height, width=width, origin=origin or (0, 0), coverage=hard, grid_bits=10
    )


def _windows(image: np.ndarray) -> list[np.ndarray]:
    return [image[y : y + HEIGHT // 2, x : x + WIDTH // 2] for x, y in ORIGINS]


@pytest.mark.parametrize("shading", ["sample", "pixel"])
@pytest.mark.parametrize("perspective", [False, True], ids=["affine", "perspective"])
def test_windows_have_the_pixels_of_the_canvas(shading, perspective):
    scene = _scene(perspective=perspective)
    plan = _plan(scene, shading, None)
    assert plan.capacity.fragments > FRAGMENTS_PER_BLOCK
    image = np.asarray(sr.render(scene, plan))
    assert np.ptp(image) > 0.5
    for origin, expected in zip(ORIGINS, _windows(image), strict=True):
        window = _plan(scene, shading, origin)
        assert window.capacity.fragments <= FRAGMENTS_PER_BLOCK
        np.testing.assert_allclose(sr.render(scene, window), expected, atol=1e-6)


@pytest.mark.parametrize("shading", ["sample", "pixel"])
def test_gradients_of_windows_sum_to_the_gradient_of_the_canvas(shading):
    scene = _scene(perspective=False)
    weight = np.random.default_rng(1).random((HEIGHT, WIDTH, 3)).astype(np.float32)

    def gradient(plan: sr.Plan, weight: np.ndarray) -> list[np.ndarray]:
        pyramid = scene.textures
        assert pyramid is not None

        def loss(colors, uv, texels):
            textures = dataclasses.replace(pyramid, texels=texels)
            changed = dataclasses.replace(scene, colors=colors, uv=uv, textures=textures)
            return jnp.sum(weight * sr.render(changed, plan))

        arguments = scene.colors, scene.uv, pyramid.texels
        both, texels = (jax.grad(loss, argnums=which)(*arguments) for which in ((0, 1), 2))
        return [np.asarray(gradient) for gradient in (*both, texels)]

    whole = gradient(_plan(scene, shading, None), weight)
    parts = [
        gradient(_plan(scene, shading, origin), part)
        for origin, part in zip(ORIGINS, _windows(weight), strict=True)
    ]
    for name, actual, *summed in zip(("colors", "uv", "texels"), whole, *parts, strict=True):
        scale = np.abs(actual).max()
        assert scale > 1
        np.testing.assert_allclose(sum(summed), actual, atol=2e-5 * scale, err_msg=name)


def test_blocks_without_fragments_do_not_change_the_image():
    scene = _scene(perspective=False)
    plan = _plan(scene, "sample", None)
    far = dataclasses.replace(scene, positions=scene.positions + jnp.array([[230.0, 0.0]]))
    tight = _plan(far, "sample", None)
    assert tight.capacity.fragments <= FRAGMENTS_PER_BLOCK < plan.capacity.fragments
    np.testing.assert_allclose(sr.render(far, plan), sr.render(far, tight), atol=1e-6)
