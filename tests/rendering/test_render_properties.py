"""Images of any triangles equal the oracle's, and moving, cropping or reordering is consistent."""

import functools

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import softras2d as sr

from ..cases.scenes import COUNT, SIZES, assert_same_counts, colors_of, vast
from ..oracles.coverage import Canvas, draw

CHOSEN = 8
"""Number of triangles that hypothesis chooses. Others lie off the canvas, to share programs."""

OFF_CANVAS = -1.0
"""A coordinate off any canvas: triangles with all corners there cover nothing."""

HEIGHT, WIDTH = SIZES[4]
COLORS = colors_of(COUNT)
BLACK = np.zeros(3, np.float32)


def _coordinate(low: int, high: int) -> st.SearchStrategy[float]:
    """Strategy for coordinates: any floats, multiples of 1/16, and multiples of 1/2.

    Multiples of 1/16 include all samples at rates 4 and 8.
    """
    return st.one_of(
        st.floats(low, high, width=32, allow_subnormal=False),
        st.integers(low * 16, high * 16).map(lambda n: n / 16),
        st.integers(low * 2, high * 2).map(lambda n: n / 2),
    )


def _soup(margin: int, coordinate=_coordinate) -> st.SearchStrategy[np.ndarray]:
    """Corners `[SHOWN, 3, 2]`, up to `margin` pixels off the canvas."""
    x, y = coordinate(-margin, WIDTH + margin), coordinate(-margin, HEIGHT + margin)
    point = st.tuples(x, y)
    # Repeated corners make zero area likely.
    triangle = st.one_of(
        st.tuples(point, point, point), st.tuples(point, point).map(lambda two: (two[0], *two))
    )
    corners = st.lists(triangle, min_size=CHOSEN, max_size=CHOSEN)
    return corners.map(lambda soup: np.array(soup, np.float32))


def _sixteenths(low: int, high: int) -> st.SearchStrategy[float]:
    """Strategy for multiples of 1/16, which the vertex grids of all canvases here contain.

    They stay on the grid when moved by whole pixels.
    """
    return st.integers(low * 16, high * 16).map(lambda n: n / 16)


RULES = st.sampled_from(["inclusive", "top_left"])
IN_BAND = max(HEIGHT, WIDTH) // 2


@functools.cache
def _plan(fill_rule: str, channels: int = 3, height: int = HEIGHT, width: int = WIDTH) -> sr.Plan:
    """A plan for the largest triangles, so that all examples share one program."""
    on = Canvas(height, width)
    colors = colors_of(COUNT, channels)
    scenes = [sr.Scene.from_soup(soup, colors, background=BLACK) for soup in vast(on, COUNT)]
    coverage = sr.Hard(samples=16, fill_rule=fill_rule)  # pyright: ignore
    return sr.plan(scenes, height=height, width=width, coverage=coverage)


def _render(corners, plan: sr.Plan, colors=COLORS, origin=(0, 0)) -> np.ndarray:
    plan = eqx.tree_at(lambda p: p.origin, plan, jnp.asarray(origin, plan.origin.dtype))
    soup = np.full((COUNT, 3, 2), np.array(origin) + OFF_CANVAS, np.float32)
    soup[: len(corners)] = corners
    scene = sr.Scene.from_soup(soup, colors, background=BLACK)
    image, overflow = sr.render_checked(scene, plan)
    assert not bool(overflow)
    return np.asarray(image)


def _expected(corners, fill_rule: str, colors=COLORS) -> np.ndarray:
    return draw(corners, colors[: len(corners)], BLACK, Canvas(HEIGHT, WIDTH, 4, fill_rule))


@given(_soup(IN_BAND), RULES)
def test_equals_the_oracle(corners, fill_rule):
    image = _render(corners, _plan(fill_rule))
    assert_same_counts(image, _expected(corners, fill_rule), 16)


@given(_soup(2), st.permutations([0, 1, 2]), RULES)
def test_order_of_corners_does_not_matter(corners, order, fill_rule):
    plan = _plan(fill_rule)
    np.testing.assert_array_equal(_render(corners[:, order], plan), _render(corners, plan))


@given(_soup(0, _sixteenths), st.integers(-5, 5), st.integers(-5, 5), RULES)
def test_moving_by_whole_pixels_moves_the_image(corners, dx, dy, fill_rule):
    plan = _plan(fill_rule)
    still = _render(corners, plan)
    moved = _render(corners + np.array([dx, dy], np.float32), plan)
    rows, columns = _overlap(dy, HEIGHT), _overlap(dx, WIDTH)
    np.testing.assert_array_equal(moved[rows[1], columns[1]], still[rows[0], columns[0]])


def _overlap(shift: int, size: int) -> tuple[slice, slice]:
    """The range of pixels that stays in view on moving by `shift`: before and after the move."""
    first, last = max(0, -shift), size - max(0, shift)
    return slice(first, last), slice(first + shift, last + shift)


@given(_soup(3, _sixteenths), st.integers(-3000, 3000), st.integers(-3000, 3000), RULES)
def test_moving_a_scene_with_its_origin_changes_nothing(corners, x, y, fill_rule):
    plan = _plan(fill_rule)
    moved = corners + np.array([x, y], np.float32)
    panned = _render(moved, plan, origin=(x, y))
    np.testing.assert_array_equal(panned, _render(corners, plan))


@given(_soup(0, _sixteenths), st.integers(0, WIDTH // 2), st.integers(0, HEIGHT // 2))
def test_a_crop_is_a_render_with_an_origin(corners, x, y):
    """Corners are multiples of 1/16, which the coarser grid of the larger canvas represents too."""
    small = Canvas(HEIGHT // 2, WIDTH // 2, origin=(x, y))
    # Triangles may leave the smaller band of the crop. Only the others are drawn.
    low, high = small.band()
    crop = corners - np.array([x, y], np.float32)
    in_band = ((crop >= low) & (crop <= high)).all(axis=(1, 2))[:, None, None]
    full_image = _render(np.where(in_band, corners, OFF_CANVAS), _plan("inclusive"))
    plan = _plan("inclusive", height=small.height, width=small.width)
    image = _render(np.where(in_band, corners, np.array([x, y]) + OFF_CANVAS), plan, origin=(x, y))
    expected = full_image[y : y + small.height, x : x + small.width]
    np.testing.assert_array_equal(image, expected)


@given(_soup(2), st.integers(0, CHOSEN - 1), RULES)
def test_a_triangle_drawn_twice_in_a_row_shows_once(corners, index, fill_rule):
    """A copy of an opaque triangle right below it, in another colour, is never visible."""
    plan = _plan(fill_rule)
    index = max(index, 1)
    below = corners.copy()
    below[index - 1] = corners[index]
    hidden = below.copy()
    hidden[index - 1] = OFF_CANVAS
    np.testing.assert_array_equal(_render(below, plan), _render(hidden, plan))


@given(_soup(2), RULES)
def test_the_last_triangle_is_in_front(corners, fill_rule):
    plan = _plan(fill_rule)
    corners[-1] = vast(Canvas(HEIGHT, WIDTH), 1)[0][0]
    alone = np.full_like(corners, OFF_CANVAS)
    alone[-1] = corners[-1]
    image, front = _render(corners, plan), _render(alone, plan)
    inside = (front == COLORS[CHOSEN - 1, 0]).all(axis=-1)
    assert inside.any()
    np.testing.assert_array_equal(image[inside], front[inside])


@pytest.mark.slow
@given(_soup(2), st.integers(0, CHOSEN - 1), RULES)
def test_alpha_zero_shows_nothing(corners, index, fill_rule):
    plan = _plan(fill_rule, channels=4)
    colors = colors_of(COUNT, 4)
    colors[index, :, 3] = 0
    without = corners.copy()
    without[index] = OFF_CANVAS
    np.testing.assert_array_equal(_render(corners, plan, colors), _render(without, plan, colors))


@given(_soup(IN_BAND), RULES)
def test_translucent_images_stay_between_their_colors(corners, fill_rule):
    colors = colors_of(COUNT, 4)
    image = _render(corners, _plan(fill_rule, channels=4), colors)
    np.testing.assert_allclose(image, _expected(corners, fill_rule, colors), rtol=0, atol=1e-6)
    assert image.min() >= 0
    assert image.max() <= colors[..., :3].max() + 1e-6


LARGEST = float(np.finfo(np.float32).max)
HUGE = st.one_of(
    st.floats(-LARGEST, LARGEST, width=32, allow_subnormal=False),
    st.floats(-1000, 1000, width=32, allow_subnormal=False),
    st.sampled_from([-LARGEST, LARGEST, 0.0, -0.0, 12.0, -1e-40]),
)


@functools.cache
def _plan_beyond_the_band() -> sr.Plan:
    corners = np.tile(np.array([(-1e4, -1e4), (3e4, -1e4), (-1e4, 3e4)]), (COUNT, 1, 1))
    scene = sr.Scene.from_soup(corners.astype(np.float32), COLORS, background=BLACK)
    return sr.plan(scene, height=HEIGHT, width=WIDTH, coverage=sr.Hard(samples=16))


@given(st.lists(HUGE, min_size=6 * CHOSEN, max_size=6 * CHOSEN))
def test_any_finite_corners_are_drawn(values):
    """No coordinate is refused, and all values of the image are in 0..1."""
    corners = np.array(values, np.float32).reshape(CHOSEN, 3, 2)
    image = _render(corners, _plan_beyond_the_band())
    assert np.isfinite(image).all()
    assert image.min() >= 0
    assert image.max() <= 1
    still = sr.Scene.from_soup(corners, COLORS[:CHOSEN])
    sr.plan(still, height=HEIGHT, width=WIDTH, coverage=sr.Hard(samples=16))
