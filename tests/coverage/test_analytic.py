"""Soft coverage and exact area of single triangles have the right values and derivatives.

Values are compared with an oracle (`oracles/analytic.py`) that clips the triangle to each pixel, or
measures the distance from its centre, in float64. Derivatives are compared with central differences
and with autodiff of a plain formula.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from softras2d.coverage import analytic, area, centroid, edge_lines, nearest_weights, profiles, soft

from ..oracles.analytic import area_in_pixel, centroid_in_pixel, distance

PROFILES = ("logistic", "softras", "window")

SIDE = 8
"""Side of a tile in pixels."""

ORIGIN = np.zeros((2, 1))


def geometry_of(slots, kind: str, tile=ORIGIN):
    """The geometry that coverage of this kind takes, for corners `[6, slots]`."""
    tile = jnp.broadcast_to(jnp.asarray(tile, slots.dtype), (2, slots.shape[1]))
    lines = edge_lines.triangle_lines(slots, tile)
    if kind == "soft":
        return lines
    outline = area.clip_outline(slots, tile, lines, SIDE)
    return outline if kind == "area" else centroid.AreaGeometry(outline, lines)


@functools.partial(jax.jit, static_argnums=(0, 1))
def cover(kind: str, name: str | int, slots, parameter, tile=ORIGIN):
    """Coverage by a profile or by area, or the weight of corner `name`."""
    shape = geometry_of(slots, kind, tile)
    if isinstance(name, int):
        weights = centroid.CentroidWeights if kind == "centroid" else nearest_weights.NearestWeights
        return analytic.evaluate(weights(SIDE), slots, shape, parameter)[name - 1]
    measure = area.AreaCoverage(SIDE) if kind == "area" else soft.SoftCoverage(SIDE, name)
    return analytic.evaluate(measure, slots, shape, parameter)


def slot_of(corners, dtype: type = np.float64):
    """The corners of one triangle as `[6, 1]`, positively oriented."""
    a, b, c = np.asarray(corners, np.float64)
    if np.cross(np.append(b - a, 0), np.append(c - a, 0))[2] < 0:
        b, c = c, b
    return jnp.asarray(np.concatenate([a, b, c])[:, None], dtype)


coordinates = st.floats(-6.0, 14.0, width=32) | st.integers(-1, 9).map(float)
triangles = st.tuples(*[st.tuples(coordinates, coordinates)] * 3)


@settings(max_examples=100)
@given(triangles)
def test_area_equals_the_clipped_polygon(corners):
    for dtype, close in ((np.float32, 2e-6), (np.float64, 1e-12)):
        with jax.enable_x64(dtype is np.float64):
            slot = slot_of(corners, dtype)
            actual = np.asarray(cover("area", "", slot, jnp.zeros((), dtype)))
        a, b, c = np.asarray(slot, np.float64)[:, 0].reshape(3, 2)
        expected = [[area_in_pixel((a, b, c), x, y) for x in range(8)] for y in range(8)]
        np.testing.assert_allclose(actual.reshape(8, 8), expected, atol=close)


@pytest.mark.parametrize("name", PROFILES)
@given(corners=triangles, width=st.floats(0.3, 5.0))
def test_soft_coverage_is_a_step_of_the_distance(name, corners, width):
    with jax.enable_x64(True):
        slot = slot_of(corners)
        actual = np.asarray(cover("soft", name, slot, jnp.asarray(width)))[0]
        corners_of_slot = np.asarray(slot)[:, 0].reshape(3, 2)
        q = [
            [distance(corners_of_slot, x + 0.5, y + 0.5) / width for x in range(8)]
            for y in range(8)
        ]
        expected = np.asarray(profiles.step(name, jnp.asarray(q)))
    np.testing.assert_allclose(actual.reshape(8, 8), expected, atol=1e-6)


@pytest.mark.parametrize("name", PROFILES)
def test_profiles_are_symmetric_steps_of_one_width(name, float64):
    support = profiles.SUPPORT[name]
    q = jnp.array([0.0, 0.5, -0.5, support, -support, 2 * support, -1e9, 1e9])
    expected = [0.5, 0.9, 0.1, 1.0, 0.0, 1.0, 0.0, 1.0]
    np.testing.assert_allclose(profiles.step(name, q), expected, atol=1e-12)
    assert np.asarray(profiles.step(name, q))[3:].tolist() == expected[3:]
    dense = jnp.linspace(-1.2 * support, 1.2 * support, 20_001)
    rise = np.asarray(profiles.step(name, dense))
    assert (np.diff(rise) >= 0).all()
    np.testing.assert_allclose(rise + rise[::-1], 1.0, atol=1e-12)
    plain = jax.vmap(jax.grad(lambda q: profiles.step(name, q)))(dense)
    inside = np.abs(dense) < 0.999 * support
    np.testing.assert_allclose(
        np.asarray(profiles.profile_derivative(name, dense))[inside],
        np.asarray(plain)[inside],
        atol=1e-9,
    )
    assert float(profiles.profile_derivative(name, q)[-1]) == 0.0


SHAPES = {
    "large": [(-3.2, 1.1), (12.7, -2.3), (4.4, 13.9)],
    "small": [(3.61, 3.72), (3.83, 3.69), (3.74, 3.91)],
    "sliver": [(0.3, 2.2), (7.6, 2.9), (7.7, 2.93)],
    "level": [(1.2, 2.3), (6.9, 2.3), (4.1, 6.6)],
    "upright": [(2.3, 1.2), (2.3, 6.9), (6.6, 4.1)],
}


SLOW = [("soft", 1), ("soft", "softras"), ("soft", "window"), ("centroid", 2)]

MEASURES = [
    ("area", ""),
    ("soft", "logistic"),
    *(pytest.param(*which, marks=pytest.mark.slow) for which in SLOW),
]


@pytest.mark.parametrize(("kind", "name"), MEASURES)
@pytest.mark.parametrize("shape", SHAPES)
def test_derivatives_equal_differences_of_the_value(kind, name, shape, float64):
    slot, width = slot_of(SHAPES[shape]), jnp.asarray(1.3)
    weight = jnp.asarray(np.random.default_rng(0).normal(size=(1, 64)))
    thin = shape in ("small", "sliver")
    if isinstance(name, int):
        if kind == "soft" and thin:
            pytest.skip("derivatives of weights are clamped in triangles thinner than a pixel")
        # Pixels that the triangle does not reach are left out, since their centroid is clamped.
        if kind == "centroid":
            weight = jnp.where(cover("area", "", slot, width) > 1e-6, weight, 0.0)

    def total(slot, width=width):
        return jnp.sum(weight * cover(kind, name, slot, width))

    jvp = jax.jit(lambda slot, change: jax.jvp(total, (slot,), (change,))[1])
    gradient = np.asarray(jax.jit(jax.grad(total))(slot))
    step = 1e-6
    for k in range(6):
        change = jnp.zeros_like(slot).at[k, 0].set(step)
        forward, backward = float(total(slot + change)), float(total(slot - change))
        difference = (forward - backward) / (2 * step)
        close = 2e-5 * max(1, np.abs(gradient).max())
        assert gradient[k, 0] == pytest.approx(difference, abs=close)
        tangent = jvp(slot, change / step)
        assert float(tangent) == pytest.approx(gradient[k, 0], abs=1e-9)
    if name in PROFILES:
        wide = jax.grad(total, 1)(slot, width)
        forward, backward = float(total(slot, width + step)), float(total(slot, width - step))
        assert float(wide) == pytest.approx((forward - backward) / (2 * step), abs=1e-5)


def signed_distance(slots, x, y):
    """Signed distance from a triangle to (x, y), in plain operations that autodiff can follow."""
    corners = slots[:, 0].reshape(3, 2)
    point = jnp.stack([x, y])
    squares, inside = [], True
    for k in range(3):
        a, edge = corners[k], corners[(k + 1) % 3] - corners[k]
        t = jnp.clip((point - a) @ edge / (edge @ edge), 0, 1)
        offset = point - a - t * edge
        squares.append(offset @ offset)
        inside &= edge[0] * (point[1] - a[1]) - edge[1] * (point[0] - a[0]) >= 0
    length = jnp.sqrt(jnp.min(jnp.stack(squares)))
    return jnp.where(inside, length, -length)


@pytest.mark.slow
@pytest.mark.parametrize("shape", ["large", "sliver"])
def test_derivatives_equal_those_of_plain_autodiff(shape, float64):
    slot, width = slot_of(SHAPES[shape]), 1.3
    x, y = jnp.meshgrid(jnp.arange(8.0) + 0.5, jnp.arange(8.0) + 0.5)
    weight = jnp.asarray(np.random.default_rng(0).normal(size=64))

    def plain(slot):
        far = jax.vmap(signed_distance, (None, 0, 0))(slot, x.ravel(), y.ravel())
        return jnp.sum(weight * profiles.step("logistic", far / width))

    def ours(slot):
        return jnp.sum(weight * cover("soft", "logistic", slot, jnp.asarray(width))[0])

    np.testing.assert_allclose(jax.grad(ours)(slot), jax.grad(plain)(slot), rtol=1e-9, atol=1e-12)
    # Second derivatives are compared too: there, JAX differentiates the closed form of the first.
    direction = jnp.asarray(np.random.default_rng(1).normal(size=(6, 1)))
    second_of_ours, second_of_plain = (
        jax.jvp(jax.grad(f), (slot,), (direction,))[1] for f in (ours, plain)
    )
    np.testing.assert_allclose(second_of_ours, second_of_plain, rtol=1e-7, atol=1e-9)


@pytest.mark.slow
@settings(max_examples=60)
@given(triangles)
def test_weights_are_those_of_the_centroid(corners):
    with jax.enable_x64(True):
        slot = slot_of(corners)
        a, b, c = np.asarray(slot)[:, 0].reshape(3, 2)
        doubled_area = np.cross(np.append(b - a, 0), np.append(c - a, 0))[2]
        actual = [np.asarray(cover("centroid", k, slot, jnp.zeros(())))[0] for k in (1, 2)]
    for number in range(64):
        x, y = number % 8, number // 8
        area = area_in_pixel((a, b, c), x, y)
        if area < 1e-5 or doubled_area < 1e-3:
            continue
        middle = centroid_in_pixel((a, b, c), x, y)
        expected = [
            np.cross(np.append(p, 0), np.append(q, 0))[2] / doubled_area
            for p, q in ((middle - a, c - a), (b - a, middle - a))
        ]
        assert [w[number] for w in actual] == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("kind", ["soft", "area"])
def test_far_corners_lose_no_digits(kind):
    rng = np.random.default_rng(0)
    # Corners lie millions of pixels away, and the edges between them cross the tile.
    x, y = rng.uniform(-5e6, 5e6, (2, 500))
    angle = rng.uniform(0, np.pi, 500)
    half_edge = np.stack([np.cos(angle), np.sin(angle)]) * 4e6
    on_tile = np.stack([rng.uniform(800, 808, 500), rng.uniform(400, 408, 500)])
    slots = np.concatenate([on_tile - half_edge, on_tile + half_edge, np.stack([x, y])])
    a, b, c = slots.reshape(3, 2, 500)
    swap = (b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0] < 0
    slots = np.where(swap, np.concatenate([b, a, c]), slots).astype(np.float32)
    tile, name = np.array([[800.0], [400.0]]), "logistic" if kind == "soft" else ""
    actual = cover(kind, name, jnp.asarray(slots), jnp.float32(1.0), tile)
    with jax.enable_x64(True):
        expected = cover(kind, name, jnp.asarray(slots, jnp.float64), jnp.asarray(1.0), tile)
    assert ((np.asarray(expected) > 0.01) & (np.asarray(expected) < 0.99)).any(1).mean() > 0.5
    np.testing.assert_allclose(actual, expected, atol=3e-6)


def test_an_edge_on_the_side_of_a_pixel_has_a_derivative(float64):
    # The triangle is half of a 3 x 3 square, whose left and top edges lie on sides of pixels. The
    # direction moves its left edge.
    slot = slot_of([(2, 2), (5, 2), (2, 5)])
    slot_order = np.asarray(slot)[:, 0].reshape(3, 2)
    left = jnp.asarray([[1.0 if x == 2 else 0.0, 0.0] for x, _ in slot_order]).reshape(6, 1)

    def total(slot):
        return jnp.sum(cover("area", "", slot, jnp.zeros(())))

    # The area is half of 3 x 3. The base shrinks by 1 per unit step and the height of 3 does not
    # change, so the area changes by -3 / 2.
    assert float(total(slot)) == pytest.approx(4.5)
    assert float(jax.jvp(total, (slot,), (left,))[1]) == pytest.approx(-1.5)


@pytest.mark.parametrize(("kind", "name"), MEASURES)
@pytest.mark.parametrize("width", [1e-6, pytest.param(1e-2, marks=pytest.mark.slow), 1e4])
def test_values_and_derivatives_of_hard_cases_are_finite(kind, name, width):
    cases = [
        [(4, 4)] * 3,
        [(1, 1), (5, 5), (3, 3)],
        [(4.5, 4.5), (4.5, 4.5), (6.5, 2.5)],
        [(3.5, 3.5), (5.5, 3.5), (3.5, 5.5)],
        [(0, 0), (8, 0), (0, 8)],
        [(0, 4), (1e6, 4), (5e5, 4.5)],
        [(-1e9, -1e9), (1e9, -1e9), (0, 1e9)],
        [(4, 4), (4 + 1e-6, 4), (4, 4 + 1e-6)],
    ]
    slots = jnp.concatenate([slot_of(case, np.float32) for case in cases], 1)

    def total(slots, width):
        return jnp.sum(cover(kind, name, slots, width) ** 2)

    value, (gradient, by_width) = jax.value_and_grad(total, (0, 1))(slots, jnp.float32(width))
    assert np.isfinite(value)
    assert np.isfinite(gradient).all()
    assert np.isfinite(by_width)
    ones = (jnp.ones_like(slots), jnp.float32(1.0))
    assert np.isfinite(jax.jvp(total, (slots, jnp.float32(width)), ones)[1])
