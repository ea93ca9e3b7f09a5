"""`simplify` removes inputs that have no effect, and never changes the image."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import softras2d as sr
from softras2d.planning.effects import EFFECTS

from ..cases.scenes import draw_scene

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
    colors = np.asarray(small.colors)
    assert colors.shape[2] == 3 or (colors[..., 3] < 1).any()
    assert colors.shape[1] == 1 or (colors != colors[:, :1]).any()
    corners_left = np.asarray(small.positions)[np.asarray(small.triangles)]
    assert ((corners_left.max(1) >= 0) & (corners_left.min(1) <= (WIDTH, HEIGHT))).all()


@pytest.mark.parametrize(
    "corners, channels, opaque",
    [
        pytest.param(1, 4, True, marks=pytest.mark.slow),
        pytest.param(3, 3, True, marks=pytest.mark.slow),
        pytest.param(3, 4, False, marks=pytest.mark.slow),
    ],
)
def test_the_image_is_the_same(corners, channels, opaque):
    scenes = [_scene(seed, corners, channels, opaque) for seed in range(3)]
    # This scene has a colour for each corner, and they are equal.
    if corners == 3:
        same = jnp.broadcast_to(scenes[0].colors[:, :1], scenes[0].colors.shape)
        scenes.append(sr.Scene.from_soup(scenes[0].positions.reshape(-1, 3, 2), same))
    plan = sr.plan(scenes, height=HEIGHT, width=WIDTH)
    for scene in scenes:
        small = sr.simplify(scene, height=HEIGHT, width=WIDTH)
        drawn = draw_scene(small, sr.plan(small, height=HEIGHT, width=WIDTH))
        np.testing.assert_allclose(drawn, draw_scene(scene, plan), atol=1e-6)


def test_constant_attributes_are_dropped():
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


@pytest.mark.parametrize(
    "depths, is_needed",
    [
        ([(5, 5, 5), (5, 5, 5)], False),
        ([(5, 6, 7), (1, 2, 3)], False),
        ([(1, 2, 3), (5, 6, 7)], True),
        ([(5, 6, 7), (1, 5.5, 3)], True),
        ([(5, 5, 5), (5, 5, 5), (3, 3, 3), (3, 3, 3)], False),
    ],
    ids=["equal", "sorted", "reversed", "crossing", "layers"],
)
def test_depth_is_dropped_where_draw_order_implies_it(depths, is_needed):
    corners = np.array([[(1, 1), (9, 1), (1, 9)]] * len(depths), np.float32)
    colors = np.ones((len(depths), 3))
    scene = sr.Scene.from_soup(corners, colors, depth=np.array(depths, np.float32))
    assert (sr.simplify(scene, height=10, width=10).depth is not None) == is_needed


def test_a_transparent_triangle_still_hides_later_ones_behind_it():
    """With a depth test, a transparent triangle writes its depth, so it must not be removed."""
    corners = np.array([[(1, 1), (9, 1), (1, 9)]] * 2, np.float32)
    colors = np.array([[1, 1, 1, 0], [1, 0, 0, 1]], np.float32)
    depth = np.array([[1, 1, 1], [2, 2, 2]], np.float32)
    scene = sr.Scene.from_soup(corners, colors, depth=depth)
    small = sr.simplify(scene, height=10, width=10)
    assert small.triangles.shape[0] == 2
    drawn = draw_scene(small, sr.plan(small, height=10, width=10))
    np.testing.assert_array_equal(drawn, 1)


def _squares(scale: float, inverse_w: bool = False) -> sr.Scene:
    """A 6 x 6 texture on two triangles over the canvas, at `scale` texels per pixel."""
    size = np.float32(HEIGHT)
    corners = np.array([[(0, 0), (1, 0), (0, 1)], [(1, 0), (1, 1), (0, 1)]], np.float32)
    image = np.random.default_rng(5).random((6, 6, 3)).astype(np.float32)
    return sr.Scene.from_soup(
        corners * size,
        np.ones((2, 3), np.float32),
        uv=corners * size * np.float32(scale / 6),
        texture_index=[0, 0],
        textures=sr.TexturePyramid.build([image], border="repeat"),
        inverse_w=np.full((2, 3), 2.0) if inverse_w else None,
    )


@pytest.mark.parametrize(
    "rule, bias",
    [
        pytest.param(*rule, marks=pytest.mark.slow)
        for rule in (("nearest", 0.0), ("linear", 0.0), ("linear", 0.5))
    ],
)
def test_mip_levels_are_dropped_exactly_where_none_is_visible(rule, bias):
    """Brute force decides whether levels are visible: the scene is drawn with and without them."""
    # At a scale of 2 a bilinear read of the base level equals one of level 1, up to rounding.
    scales = [0.5, 0.7, 0.72, 0.99, 1.0, 1.01, 1.4, 1.42, 2.1]
    scenes = [_squares(scale) for scale in scales]
    size = {"height": HEIGHT, "width": HEIGHT, "coverage": sr.Hard(samples=1)}
    full, flat = (
        sr.plan(scenes, filter=sr.Filter(level=level, lod_bias=bias), **size)
        for level in (rule, "zero")
    )
    needed = []
    for scene in scenes:
        drawn, base = draw_scene(scene, full), draw_scene(scene, flat)
        needed.append(bool(np.abs(drawn - base).max() > 2e-6))
        filter = sr.Filter(level=rule, lod_bias=bias)
        small = sr.simplify(scene, height=HEIGHT, width=HEIGHT, filter=filter)
        assert small.textures is not None
        assert (small.textures.depth > 1) == needed[-1]
    assert True in needed and False in needed


def test_levels_stay_without_a_filter():
    small = sr.simplify(_squares(0.5), height=HEIGHT, width=HEIGHT)
    assert small.textures is not None and small.textures.depth > 1
    zero = sr.simplify(_squares(2), height=HEIGHT, width=HEIGHT, filter=sr.Filter(level="zero"))
    assert zero.textures is not None and zero.textures.texels.shape == (36, 3)


def test_constant_inverse_w_is_dropped():
    assert sr.simplify(_squares(1, inverse_w=True), height=9, width=9).inverse_w is None
    bent = np.arange(1.0, 7.0).reshape(2, 3)
    flat = sr.Scene.from_soup(np.ones((2, 3, 2)), np.ones((2, 3)), inverse_w=bent)
    assert sr.simplify(flat, height=9, width=9).inverse_w is None


def test_unused_textures_and_opaque_alpha_are_dropped():
    rng = np.random.default_rng(2)
    images = [rng.random((size, size, 4)).astype(np.float32) for size in (3, 5, 4)]
    for image in images[1:]:
        image[..., 3] = 1
    scene = sr.Scene.from_soup(
        rng.uniform(0, 9, (3, 3, 2)),
        np.ones((3, 4)),
        uv=rng.random((3, 3, 2)),
        texture_index=[2, -1, 1],
        textures=sr.TexturePyramid.build(images),
    )
    small = sr.simplify(scene, height=9, width=9)
    assert small.textures is not None and small.texture_index is not None
    assert small.colors.shape[2] == 3 and small.textures.channels == 3
    np.testing.assert_array_equal(small.texture_index, [1, -1, 0])
    for old, new in ((1, 0), (2, 1)):
        start, height, width = np.asarray(small.textures.levels)[new, 0]
        base = np.asarray(small.textures.texels)[start : start + height * width]
        np.testing.assert_array_equal(base.reshape(height, width, 3), images[old][..., :3])


def _with_random_effects(seed: int) -> tuple[sr.Scene, sr.Filter]:
    """A scene in which chance decides for each effect whether it is present, and if so visible."""
    rng = np.random.default_rng(seed)

    def flip() -> bool:
        return bool(rng.random() < 0.5)

    scene = _scene(seed, 3 if flip() else 1, 4 if flip() else 3, flip())
    corners, colors = scene.positions.reshape(-1, 3, 2), np.array(scene.colors)
    if flip():
        colors[:] = colors[:, :1]
    effects = {}
    if flip():
        depth = rng.random((COUNT, 3)).astype(np.float32)
        effects["depth"] = np.sort(depth.ravel())[::-1].reshape(COUNT, 3) if flip() else depth
    if flip():
        inverse_w = rng.uniform(0.2, 2, (COUNT, 3)).astype(np.float32)
        effects["inverse_w"] = np.repeat(inverse_w[:, :1], 3, 1) if flip() else inverse_w
    if flip():
        images = [rng.random((n, n + 1, 4 if flip() else 3)).astype(np.float32) for n in (3, 8)]
        effects["textures"] = sr.TexturePyramid.build(images, border="repeat")
        effects["texture_index"] = rng.integers(-1, 2, COUNT)
        effects["uv"] = rng.random((COUNT, 3, 2)) * (0.1 if flip() else 10)
    levels = ("zero", "nearest", "linear")
    filter = sr.Filter(
        level=levels[rng.integers(3)], lod_bias=float(rng.uniform(-1, 1)) if flip() else 0.0
    )
    return sr.Scene.from_soup(corners, colors, background=scene.background, **effects), filter


def _assert_the_same_image(seed: int) -> None:
    scene, filter = _with_random_effects(seed)
    small = sr.simplify(scene, height=HEIGHT, width=WIDTH, filter=filter)
    hard = sr.Hard(samples=4, shading="pixel" if seed % 2 else "sample")
    size = {"height": HEIGHT, "width": WIDTH, "coverage": hard, "filter": filter}
    before, after = sr.plan(scene, **size), sr.plan(small, **size)
    assert set(after.effects) <= set(before.effects) <= set(EFFECTS)
    np.testing.assert_allclose(draw_scene(small, after), draw_scene(scene, before), atol=4e-6)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_random_effects_do_not_change_the_image(seed):
    _assert_the_same_image(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 4))
def test_more_random_effects_do_not_change_the_image(seed):
    _assert_the_same_image(seed)


def test_a_scene_of_clear_triangles_becomes_empty():
    clear = sr.Scene.from_soup([[(1, 1), (5, 1), (1, 5)]], [[1.0, 1, 1, 0]])
    small = sr.simplify(clear, height=4, width=4)
    assert small.triangles.shape == (0, 3)
    image = sr.render(small, sr.plan(small, height=4, width=4))
    np.testing.assert_array_equal(image, 1)
