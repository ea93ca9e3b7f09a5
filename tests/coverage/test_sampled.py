"""Sampled coverage (`Hard`) equals an oracle in exact integers, in every pixel.

Coverage is decided exactly on both sides, so there is no tolerance: `assert_same_counts` requires
every pixel to be the mean of the same samples.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..cases.marks import slowly
from ..cases.scenes import (
    COUNT,
    assert_same_counts,
    canvas,
    cases,
    colors_of,
    draw_scene,
    parked,
    vast,
)
from ..oracles.coverage import Canvas, draw

BLACK = np.zeros(3, np.float32)


RATES_AND_RULES = pytest.mark.parametrize(
    "rate, fill_rule",
    [(4, "inclusive"), (16, "top_left")]
    + [slowly(rate, "inclusive") for rate in (1, 3, 8, 16)]
    # `test_fill_rules.py` draws tilings at the other rates under this rule.
    + [slowly(rate, "top_left") for rate in (2, 3)],
)


def _plan(scenes, on: Canvas, **options) -> sr.Plan:
    coverage = sr.Hard(samples=on.samples, fill_rule=on.fill_rule)  # pyright: ignore
    return sr.plan(
        scenes, height=on.height, width=on.width, coverage=coverage, origin=on.origin, **options
    )


def _shared_plan(on: Canvas, colors: np.ndarray, background=BLACK) -> sr.Plan:
    """A plan that fits every case, and nearly any `COUNT` triangles in the band."""
    soups = [*vast(on, COUNT), *cases(on).values()]
    return _plan([sr.Scene.from_soup(soup, colors, background=background) for soup in soups], on)


@RATES_AND_RULES
def test_each_hard_triangle_alone_equals_the_oracle(rate, fill_rule):
    """Each triangle of a case is drawn alone, among others that cover nothing."""
    on = canvas(rate, fill_rule)
    colors = colors_of(COUNT)
    plan = _shared_plan(on, colors)
    for name, corners in cases(on).items():
        for index in range(COUNT):
            alone = parked(on, COUNT).astype(np.float32)
            alone[index] = corners[index]
            image = draw_scene(sr.Scene.from_soup(alone, colors, background=BLACK), plan)
            expected = draw(corners[index][None], colors[index][None], BLACK, on)
            try:
                assert_same_counts(image, expected, on.samples)
            except AssertionError as error:
                raise AssertionError(f"{name} {corners[index].tolist()}: {error}") from None


def _check_cases(on: Canvas) -> None:
    colors = colors_of(COUNT)
    plan = _shared_plan(on, colors)
    for name, corners in cases(on).items():
        image = draw_scene(sr.Scene.from_soup(corners, colors, background=BLACK), plan)
        try:
            assert_same_counts(image, draw(corners, colors, BLACK, on), on.samples)
        except AssertionError as error:
            raise AssertionError(f"{name}: {error}") from None


@RATES_AND_RULES
def test_layered_hard_triangles_equal_the_oracle(rate, fill_rule):
    """All triangles of a case are drawn together, later ones in front."""
    _check_cases(canvas(rate, fill_rule))


@pytest.mark.parametrize(
    "height, width, rate",
    [(1, 1, 4), (33, 17, 2), slowly(1, 37, 4), slowly(3, 2, 16)],
)
def test_canvases_of_any_size_equal_the_oracle(height, width, rate):
    """No canvas is a whole number of tiles both in width and in height."""
    _check_cases(Canvas(height, width, rate))


@pytest.mark.slow
@pytest.mark.parametrize("side, rate", [slowly(64, 1), (32, 4)])
def test_triangles_over_the_full_grid_equal_the_oracle(side, rate):
    """If the longer side is a power of two, triangles of the band span all 2^23 grid units."""
    _check_cases(Canvas(side, side, rate))


@pytest.mark.slow
@pytest.mark.parametrize(
    "height, width, rate",
    [
        (37, 1, 16),
        (64, 64, 3),
        *((31, 129, rate) for rate in (4, 8)),
        (5, 6, 1),
        (3, 1500, 2),
    ],
)
def test_more_sizes_equal_the_oracle(height, width, rate):
    _check_cases(Canvas(height, width, rate, "top_left"))


def test_a_scene_without_triangles_is_its_background():
    on = Canvas(21, 29)
    for background in ([0.25, 0.5, 0.75], [0.25, 0.5, 0.75, 0.5], [1.0, 1.0, 1.0, 0.0]):
        empty = sr.Scene.from_soup(np.zeros((0, 3, 2)), np.zeros((0, 3)), background=background)
        image = draw_scene(empty, _plan(empty, on))
        wanted = background if background[-1] else [0, 0, 0, 0]
        np.testing.assert_array_equal(image, np.broadcast_to(wanted, (21, 29, len(wanted))))


def test_one_triangle_equals_the_oracle():
    on = Canvas(21, 29)
    corners = np.array([[[3.125, 2.0], [20.5, 4.25], [8.0, 19.875]]], np.float32)
    scene = sr.Scene.from_soup(corners, colors_of(1))
    image = draw_scene(scene, _plan(scene, on))
    assert_same_counts(image, draw(corners, colors_of(1), np.ones(3), on), on.samples)


@pytest.mark.slow
@pytest.mark.parametrize("channels", [3, 4])
def test_three_hundred_layers_equal_the_oracle(channels):
    on = Canvas(21, 29)
    rng = np.random.default_rng(5)
    corners = ([14, 11] + rng.normal(size=(300, 3, 2)) * [3, 2]).astype(np.float32)
    colors = colors_of(300, channels)
    colors[..., 3:] *= 0.125
    scene = sr.Scene.from_soup(corners, colors)
    image, expected = draw_scene(scene, _plan(scene, on)), draw(corners, colors, np.ones(3), on)
    if channels == 3:
        assert_same_counts(image, expected, on.samples)
    np.testing.assert_allclose(image, expected, rtol=0, atol=2e-6)


@pytest.mark.slow
def test_two_thousand_small_triangles_equal_the_oracle():
    on = Canvas(100, 75)
    rng = np.random.default_rng(6)
    centres = rng.uniform(0, 1, (2000, 1, 2)) * [75, 100]
    corners = (centres + rng.normal(size=(2000, 3, 2)) * 2).astype(np.float32)
    colors = colors_of(2000)
    scene = sr.Scene.from_soup(corners, colors)
    assert_same_counts(
        draw_scene(scene, _plan(scene, on)), draw(corners, colors, np.ones(3), on), on.samples
    )


def _check_colors(on: Canvas, channels: int, corners: int, background: int) -> None:
    colors = colors_of(COUNT, channels, corners, seed=1)
    back = np.array([0.25, 0.5, 1.0, 0.5], np.float32)[:background]
    plan = _shared_plan(on, colors, back)
    for name, points in cases(on).items():
        image = draw_scene(sr.Scene.from_soup(points, colors, background=back), plan)
        expected = draw(points, colors, back, on)
        assert image.shape == expected.shape
        np.testing.assert_allclose(image, expected, rtol=0, atol=2e-6, err_msg=name)


@pytest.mark.parametrize(
    "corners, channels, background",
    [
        (1, 4, 3),
        (3, 3, 3),
        (1, 3, 4),
        (3, 4, 4),
        *(slowly(*rest) for rest in ((1, 4, 4), (3, 3, 4), (3, 4, 3))),
    ],
)
def test_colors_equal_the_oracle(corners, channels, background):
    """Colours are flat or interpolated, opaque or translucent, over backgrounds of both kinds."""
    _check_colors(canvas(4), channels, corners, background)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [3, slowly(16)])
def test_interpolated_translucent_at_other_rates(rate):
    _check_colors(canvas(rate, "top_left"), channels=4, corners=3, background=4)


@pytest.mark.slow
@pytest.mark.parametrize("rate, fill_rule", [(1, "inclusive"), (8, "top_left")])
@pytest.mark.parametrize("channels, corners", [(3, 3), (4, 1), (4, 3)])
def test_colors_at_all_rates(rate, fill_rule, channels, corners):
    _check_colors(canvas(rate, fill_rule), channels, corners, background=3)


def test_translucent_layers_count_samples():
    """A few layers at alpha 1/2 are exact in float32, so any sample in a wrong pixel would show."""
    on = canvas(4)
    colors = np.zeros((COUNT, 1, 4), np.float32)
    # Only every eighth triangle is visible, so at most five layers are blended at a sample.
    colors[::8, :, 3] = 0.5
    colors[::8, :, :3] = colors_of(COUNT)[::8]
    plan = _shared_plan(on, colors)
    for corners in cases(on).values():
        image = draw_scene(sr.Scene.from_soup(corners, colors, background=BLACK), plan)
        np.testing.assert_array_equal(image, draw(corners, colors, BLACK, on).astype(np.float32))


def test_alpha_one_is_opaque():
    on = canvas(4)
    corners = np.concatenate(list(cases(on).values()))[::9]
    corners = corners[:COUNT]
    colors = colors_of(COUNT)
    solid = np.concatenate([colors, np.ones((COUNT, 1, 1), np.float32)], axis=-1)
    expected = draw(corners, colors, BLACK, on)
    image = draw_scene(
        sr.Scene.from_soup(corners, solid, background=BLACK), _shared_plan(on, solid)
    )
    assert_same_counts(image, expected, on.samples)


@pytest.mark.slow
def test_thin_and_long_keeps_its_colors():
    """Slivers a million times as long as thick keep their corner colours along their length."""
    on = Canvas(8, 2048)
    thin = 2.0**-on.exponent
    y = 4.125
    corners = np.array(
        [
            [(-1000, y - thin), (3000, y), (-1000, y + thin)],
            [(3000, y + 1), (1000, y + 1 - thin), (-1000, y + 1 + thin)],
            [(-1000, y - 3), (3000, y - 3), (0, y - 3)],
        ],
        np.float32,
    )
    colors = colors_of(3, 3, 3, seed=3)
    scene = sr.Scene.from_soup(corners, colors)
    image, expected = draw_scene(scene, _plan(scene, on)), draw(corners, colors, np.ones(3), on)
    assert (expected != 1).any(axis=-1).sum() > 3 * 1000
    np.testing.assert_allclose(image, expected, rtol=0, atol=2e-6)


def test_origin():
    on = canvas(4, origin=(4096, -512))
    move = np.array(on.origin, np.float32)
    colors = colors_of(COUNT)
    scenes = [
        sr.Scene.from_soup(corners + move, colors, background=BLACK) for corners in vast(on, COUNT)
    ]
    plan = _plan(scenes, on)
    for name in ("on_samples", "halves", "degenerate", "in_band"):
        # Moved corners are rounded to float32 before the oracle gets them too.
        corners = np.clip(cases(on)[name] + move, *(bound + move for bound in on.band()))
        corners = corners.astype(np.float32)
        image = draw_scene(sr.Scene.from_soup(corners, colors, background=BLACK), plan)
        assert_same_counts(image, draw(corners, colors, BLACK, on), on.samples)


@pytest.mark.slow
def test_jit_vmap_and_eager_agree():
    on = canvas(4)
    colors = colors_of(COUNT)
    plan = _shared_plan(on, colors)
    scenes = [sr.Scene.from_soup(c, colors, background=BLACK) for c in cases(on).values()]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenes)
    eager = np.stack([np.asarray(sr.render(scene, plan)) for scene in scenes])
    checked, overflow = jax.vmap(lambda scene: sr.render_checked(scene, plan))(batch)
    np.testing.assert_array_equal(checked, eager)
    assert not np.asarray(overflow).any()
    np.testing.assert_array_equal(jax.jit(sr.render)(scenes[3], plan), eager[3])
    batched = jax.jit(jax.vmap(sr.render, in_axes=(0, None)))
    np.testing.assert_array_equal(batched(batch, plan), eager)


@pytest.mark.slow
def test_vmap_of_interpolated_translucent():
    on = canvas(4)
    colors = colors_of(COUNT, 4, 3)
    plan = _shared_plan(on, colors)
    scenes = [sr.Scene.from_soup(c, colors, background=BLACK) for c in cases(on).values()]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenes)
    eager = np.stack([np.asarray(sr.render(scene, plan)) for scene in scenes])
    image = jax.jit(jax.vmap(sr.render, in_axes=(0, None)))(batch, plan)
    np.testing.assert_allclose(image, eager, rtol=0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("fill_rule", ["inclusive", slowly("top_left")])
def test_float64_gives_the_same_image(fill_rule):
    on = canvas(4, fill_rule)
    colors = colors_of(COUNT)
    plan = _shared_plan(on, colors)
    single = [
        draw_scene(sr.Scene.from_soup(c, colors, background=BLACK), plan)
        for c in cases(on).values()
    ]
    with jax.enable_x64(True):
        wide = colors.astype(np.float64)
        plan = _plan(
            [
                sr.Scene.from_soup(c.astype(np.float64), wide, background=BLACK)
                for c in vast(on, COUNT)
            ],
            on,
        )
        for corners, expected in zip(cases(on).values(), single, strict=True):
            scene = sr.Scene.from_soup(corners.astype(np.float64), wide, background=BLACK)
            image, overflow = sr.render_checked(scene, plan)
            assert image.dtype == np.float64
            assert not bool(overflow)
            np.testing.assert_array_equal(image, expected)


@pytest.mark.slow
def test_corner_colors_of_large_triangles_at_256_samples():
    """Sums of edge values near 2^31 over 256 samples overflow int32.

    A float estimate must recover the multiple of 2^32 that overflow drops.
    """
    on = Canvas(16, 16, rate=16)
    rng = np.random.default_rng(3)
    for _ in range(4):
        corners = np.array([[(-8, 24), (24, -8), (24, 24)]], np.float32)
        corners = np.clip(corners + rng.uniform(-0.1, 0.1, (1, 3, 2)), -8, 24).astype(np.float32)
        colors = rng.uniform(0, 1, (1, 3, 3)).astype(np.float32)
        scene = sr.Scene.from_soup(corners, colors)
        plan = sr.plan(scene, height=16, width=16, coverage=sr.Hard(samples=256))
        wanted = draw(corners, colors, np.ones(3), on)
        np.testing.assert_allclose(sr.render(scene, plan), wanted, atol=2e-6)
