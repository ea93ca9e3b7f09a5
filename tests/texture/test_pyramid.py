"""All levels of a texture pyramid have the mean of the image, and are stored in one array."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

SIZES = [(1, 1), (1, 2), (2, 1), (4, 4), (5, 5), (1, 7), (7, 1), (3, 5), (6, 9), (33, 17), (64, 31)]


def _image(height: int, width: int, channels: int = 3, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((height, width, channels))


def _levels(pyramid: sr.TexturePyramid, texture: int = 0) -> list[np.ndarray]:
    """The images of all levels of a texture, read through the table of offsets."""
    texels = np.asarray(pyramid.texels)
    images = []
    for offset, height, width in np.asarray(pyramid.levels)[texture]:
        level_texels = texels[offset : offset + height * width]
        images.append(level_texels.reshape(height, width, -1))
    return images


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_every_level_keeps_the_mean(size, float64):
    image = _image(*size)
    for level in _levels(sr.TexturePyramid.build([image])):
        np.testing.assert_allclose(level.mean(axis=(0, 1)), image.mean(axis=(0, 1)), rtol=1e-13)


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_levels_halve_down_to_one_texel(size):
    levels = _levels(sr.TexturePyramid.build([_image(*size).astype(np.float32)]))
    assert levels[0].shape[:2] == size
    assert levels[-1].shape[:2] == (1, 1)
    for fine, coarse in pairwise(levels):
        assert coarse.shape[:2] == tuple(max(side // 2, 1) for side in fine.shape[:2])


@pytest.mark.parametrize("size", [(5, 1), (7, 1), (9, 1), (33, 1)], ids=str)
def test_odd_sizes_weigh_every_texel_equally(size, float64):
    """All columns of the reduction have one sum, and all rows sum to 1."""
    side = size[0]
    reduction = []
    for index in range(side):
        unit = np.zeros((side, 1, 3))
        unit[index] = 1
        reduction.append(_levels(sr.TexturePyramid.build([unit]))[1][:, 0, 0])
    matrix = np.stack(reduction, axis=1)
    np.testing.assert_allclose(matrix.sum(axis=1), 1, rtol=1e-14)
    np.testing.assert_allclose(matrix.sum(axis=0), (side // 2) / side, rtol=1e-14)
    # A texel of the next level weighs only the texels that its footprint overlaps.
    for row, weights in enumerate(matrix):
        touched = np.flatnonzero(weights)
        assert touched.min() >= 2 * row
        assert touched.max() <= 2 * row + 2


def test_even_sizes_average_two_by_two():
    image = _image(4, 6).astype(np.float32)
    expected = image.reshape(2, 2, 3, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(_levels(sr.TexturePyramid.build([image]))[1], expected, rtol=1e-6)


def test_memory_is_four_thirds_of_the_image():
    pyramid = sr.TexturePyramid.build([np.zeros((256, 256, 3), np.float32)])
    assert pyramid.texels.shape[0] <= 256 * 256 * 4 / 3 + 1
    thin = sr.TexturePyramid.build([np.zeros((1, 1024, 3), np.float32)])
    assert thin.texels.shape[0] == 2047


def test_textures_of_any_sizes_share_one_array():
    images = [_image(5, 3, 3, 1), _image(1, 1, 4, 2), _image(8, 16, 4, 3)]
    images = [image.astype(np.float32) for image in images]
    pyramid = sr.TexturePyramid.build(images)
    assert pyramid.count == 3
    assert pyramid.texels.shape[1] == 4
    used = np.zeros(pyramid.texels.shape[0], int)
    for texture, image in enumerate(images):
        levels = _levels(pyramid, texture)
        alpha = image[..., 3:] if image.shape[-1] == 4 else np.float32(1)
        np.testing.assert_array_equal(levels[0][..., :3], image[..., :3] * alpha)
        # Textures with fewer levels repeat their last one in the table.
        assert levels[-1].shape[:2] == (1, 1)
        for offset, height, width in {tuple(row) for row in np.asarray(pyramid.levels)[texture]}:
            used[offset : offset + height * width] += 1
    np.testing.assert_array_equal(used, 1)
    np.testing.assert_array_equal(_levels(pyramid, 0)[0][..., 3], 1)


def test_a_transparent_texel_adds_no_colour():
    image = np.array([[[1, 0, 0, 1], [0, 1, 0, 0]]], np.float32)
    np.testing.assert_array_equal(
        _levels(sr.TexturePyramid.build([image]))[1][0, 0], [0.5, 0, 0, 0.5]
    )


def test_integer_images_become_float32():
    assert sr.TexturePyramid.build([np.ones((2, 2, 3), int)]).texels.dtype == jnp.float32


def test_linear_decodes_before_averaging(float64):
    image = np.zeros((1, 2, 4))
    image[0, 1, :3] = 1
    image[..., 3] = 0.5
    gray = np.full((1, 1, 3), 0.5)
    pyramid = sr.TexturePyramid.build([image, gray], linear=True)
    np.testing.assert_allclose(_levels(pyramid, 0)[1][0, 0], [0.25, 0.25, 0.25, 0.5])
    # IEC 61966-2-1: 0.5 in sRGB is 0.214 in linear light.
    np.testing.assert_allclose(_levels(pyramid, 1)[0][0, 0, :3], 0.21404114048, rtol=1e-9)


def test_texels_are_differentiable_by_the_images():
    def last_texel(image):
        return sr.TexturePyramid.build([image]).texels[-1].sum()

    gradient = jax.jit(jax.grad(last_texel))(jnp.ones((5, 6, 3), jnp.float32))
    np.testing.assert_allclose(gradient, 1 / 30, rtol=1e-5)


@pytest.mark.parametrize(
    "shape", [(0, 4, 3), (4, 0, 3), (4, 4), (4, 4, 2), (4, 4, 5), (1, 4, 4, 3)], ids=str
)
def test_images_of_wrong_shape_are_refused(shape):
    good = np.zeros((2, 2, 3), np.float32)
    with pytest.raises(ValueError, match="texture 1"):
        sr.TexturePyramid.build([good, np.zeros(shape, np.float32)])


def test_bytes_and_bad_alpha_are_refused():
    with pytest.raises(ValueError, match="divide bytes by 255"):
        sr.TexturePyramid.build([np.full((2, 2, 3), 200, np.uint8)])
    textures = sr.TexturePyramid.build([np.full((2, 2, 4), 1.25, np.float32)])
    corners = np.zeros((1, 3, 2), np.float32)
    with pytest.raises(ValueError, match="texels alpha"):
        sr.Scene.from_soup(
            corners, np.ones((1, 3)), uv=corners, texture_index=[0], textures=textures
        )


def test_texels_take_the_dtype_of_the_positions(float64):
    textures = sr.TexturePyramid.build([np.ones((2, 2, 3))])
    corners = np.zeros((1, 3, 2), np.float32)
    scene = sr.Scene.from_soup(
        corners, np.ones((1, 3)), uv=corners, texture_index=[0], textures=textures
    )
    assert scene.textures is not None and scene.textures.texels.dtype == jnp.float32


def test_no_images_and_unknown_options_are_refused():
    with pytest.raises(ValueError, match="at least one"):
        sr.TexturePyramid.build([])
    for option in ({"border": "mirror"}, {"addressing": "gl"}):
        # Users get a `ValueError`. In tests, run-time type checks may raise a `TypeError` first.
        with pytest.raises((ValueError, TypeError), match=next(iter(option))):
            sr.TexturePyramid.build([np.zeros((1, 1, 3))], **option)  # pyright: ignore
