"""`simplify` drops what does not show, and never changes the image."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import softras2d as sr

from .cases import draw_scene

HEIGHT, WIDTH, COUNT = 20, 24, 12


def _scene(seed: int, corners: int, channels: int, opaque: bool) -> sr.Scene:
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-30, 50, (COUNT, 3, 2)).astype(np.float32)
    colors = rng.integers(0, 5, (COUNT, corners, channels)).astype(np.float32) / 4
    if opaque and channels == 4:
        colors[..., 3] = 1
    return sr.Scene.from_soup(positions, colors, background=[0.25, 0.5, 0.75])


@given(
    seed=st.integers(0, 1000),
    corners=st.sampled_from([1, 3]),
    channels=st.sampled_from([3, 4]),
    opaque=st.booleans(),
)
def test_structure_is_the_smallest(seed, corners, channels, opaque):
    scene = _scene(seed, corners, channels, opaque)
    small = sr.simplify(scene, height=HEIGHT, width=WIDTH)
    kept = np.asarray(small.colors)
    assert kept.shape[2] == 3 or (kept[..., 3] < 1).any()
    assert kept.shape[1] == 1 or (kept != kept[:, :1]).any()
    corners_left = np.asarray(small.positions)[np.asarray(small.triangles)]
    assert ((corners_left.max(1) >= 0) & (corners_left.min(1) <= (WIDTH, HEIGHT))).all()


@pytest.mark.parametrize("corners, channels, opaque", [(1, 4, True), (3, 3, True), (3, 4, False)])
def test_the_image_is_the_same(corners, channels, opaque):
    scenes = [_scene(seed, corners, channels, opaque) for seed in range(3)]
    # Equal corner colours, in a scene that could have others.
    if corners == 3:
        same = jnp.broadcast_to(scenes[0].colors[:, :1], scenes[0].colors.shape)
        scenes.append(sr.Scene.from_soup(scenes[0].positions.reshape(-1, 3, 2), same))
    plan = sr.plan(scenes, height=HEIGHT, width=WIDTH)
    for scene in scenes:
        small = sr.simplify(scene, height=HEIGHT, width=WIDTH)
        drawn = draw_scene(small, sr.plan(small, height=HEIGHT, width=WIDTH))
        np.testing.assert_allclose(drawn, draw_scene(scene, plan), atol=1e-6)


def test_what_is_constant_goes():
    corners = np.array([[(1, 1), (9, 1), (1, 9)], [(2, 2), (9, 2), (2, 9)]], np.float32)
    textures = sr.TexturePyramid.build([np.zeros((2, 2, 3), np.float32)])
    scene = sr.Scene.from_soup(
        corners,
        np.ones((2, 3, 4), np.float32),
        uv=np.zeros((2, 3, 2)),
        texture_index=[-1, -1],
        textures=textures,
        depth=np.full((2, 3), 5.0),
        inverse_w=np.full((2, 3), 2.0),
    )
    small = sr.simplify(scene, height=10, width=10)
    assert small.colors.shape == (2, 1, 3)
    assert small.textures is None and small.uv is None and small.texture_index is None
    assert small.depth is None and small.inverse_w is None
    two = sr.Scene.from_soup(corners, np.ones((2, 3)), depth=np.arange(6.0).reshape(2, 3))
    assert sr.simplify(two, height=10, width=10).depth is not None


def test_nothing_left():
    clear = sr.Scene.from_soup([[(1, 1), (5, 1), (1, 5)]], [[1.0, 1, 1, 0]])
    small = sr.simplify(clear, height=4, width=4)
    assert small.triangles.shape == (0, 3)
    image = sr.render(small, sr.plan(small, height=4, width=4))
    np.testing.assert_array_equal(image, 1)
