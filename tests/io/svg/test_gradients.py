"""SVG gradients have the colours that SVG defines, at points away from edges.

The expected colour of a point is computed from the stops and the geometry of the gradient alone.
"""

import math
import warnings

import numpy as np
import pytest

from softras2d.io.svg.painting.gradient_circles import circles_of
from softras2d.io.svg.painting.gradient_pieces import RadialGradient
from softras2d.io.svg.reading.reader import parse_svg

from ...cases.drawings import colors_at

STOPS = '<stop offset="0" stop-color="#000"/><stop offset="1" stop-color="#fff"/>'
RNG = np.random.default_rng(0)
POINTS = RNG.random((40, 2)) * [96, 76] + [2.03, 2.07]


def read(gradient, shape='<rect width="100" height="80" fill="url(#g)"/>', **options):
    head = '<svg xmlns="http://www.w3.org/2000/svg" width="100" height="80">'
    # A shape that covers the canvas is drawn as triangles too: a gradient is no background colour.
    return parse_svg(f"{head}{gradient}{shape}</svg>", **options)


def grey(scene):
    colors = colors_at(scene, POINTS)
    np.testing.assert_allclose(colors, colors[:, :1] * np.ones(3), atol=1e-6)
    return colors[:, 0]


SPREADS = {
    "pad": lambda t: np.clip(t, 0, 1),
    "repeat": lambda t: t % 1,
    "reflect": lambda t: 1 - np.abs(t % 2 - 1),
}


@pytest.mark.parametrize("spread", SPREADS)
def test_linear_gradients_are_exact(spread):
    gradient = (
        f'<linearGradient id="g" gradientUnits="userSpaceOnUse" x1="30" y1="20" x2="50" y2="30" '
        f'spreadMethod="{spread}">{STOPS}</linearGradient>'
    )
    t = ((POINTS - [30, 20]) @ [20, 10]) / 500
    wanted = SPREADS[spread](t)
    # Points near jumps of colour are left out: strips end 4e-5 gradient lengths beside the stops.
    is_smooth = np.abs((t + 0.5) % 1 - 0.5) > 1e-3
    np.testing.assert_allclose(grey(read(gradient))[is_smooth], wanted[is_smooth], atol=2e-4)


def test_units_of_the_bounding_box_and_transforms():
    gradient = f'<linearGradient id="g" gradientTransform="rotate(90)">{STOPS}</linearGradient>'
    np.testing.assert_allclose(grey(read(gradient)), POINTS[:, 1] / 80, atol=2e-4)
    moved = '<g transform="scale(2)"><rect width="50" height="40" fill="url(#g)"/></g>'
    np.testing.assert_allclose(grey(read(gradient, moved)), POINTS[:, 1] / 80, atol=2e-4)


@pytest.mark.parametrize("spread", SPREADS)
@pytest.mark.parametrize("focus", [(50, 40), (40, 30)])
def test_radial_gradients_are_within_the_tolerance(spread, focus):
    gradient = (
        '<radialGradient id="g" gradientUnits="userSpaceOnUse" cx="50" cy="40" r="30" '
        f'fx="{focus[0]}" fy="{focus[1]}" spreadMethod="{spread}">{STOPS}</radialGradient>'
    )
    # A ray from the focus meets the circle of position 1 where |focus + s d - center| = r.
    d, f = POINTS - focus, np.subtract(focus, [50, 40])
    a, b, c = (d**2).sum(axis=1), d @ f, f @ f - 900
    t = a / (-b + np.sqrt(b**2 - a * c))
    is_smooth = np.abs((t + 0.5) % 1 - 0.5) > 5e-3
    wanted = SPREADS[spread](t)
    np.testing.assert_allclose(grey(read(gradient))[is_smooth], wanted[is_smooth], atol=3e-3)


def test_halving_the_tolerance_takes_more_rays():
    gradient = f'<radialGradient id="g" spreadMethod="repeat" r=".2">{STOPS}</radialGradient>'
    coarse, fine = (
        read(gradient, tolerance=tolerance).triangles.shape[0] for tolerance in (0.4, 0.1)
    )
    assert fine == pytest.approx(2 * coarse, rel=0.2)


@pytest.mark.parametrize(
    ("center", "radius", "focus", "start_radius", "position"),
    [
        # A jump near a large start circle.
        ([50, 40], 80, [50, 40], 30, 0.1),
        ([50, 40], 60, [45, 38], 25, 0.2),
        # Repeated circles, which are far larger than their distance from the apex.
        ([50, 40], 12, [40, 40], 0, 15.5),
        ([50, 40], 12, [43, 33], 1, 25.5),
    ],
)
def test_circles_are_within_the_tolerance(center, radius, focus, start_radius, position):
    """Two flat colours meet at the circle of a position, within 0.02 pixels on both sides."""
    offset, spread = position % 1, "repeat" if position > 1 else "pad"
    stops = f'<stop/><stop offset="{offset}"/><stop offset="{offset}" stop-color="#fff"/>'
    scene = read(
        f'<radialGradient id="g" gradientUnits="userSpaceOnUse" cx="{center[0]}" cy="{center[1]}" '
        f'r="{radius}" fx="{focus[0]}" fy="{focus[1]}" fr="{start_radius}" '
        f'spreadMethod="{spread}">{stops}</radialGradient>'
    )
    axis = np.subtract(center, focus)
    middle = focus + position * axis
    circle_radius = start_radius + position * (radius - start_radius)
    # The side of the circle that faces the focus is the one in the canvas.
    angle = math.atan2(*-axis[::-1]) + np.linspace(-1.0, 1.0, 4001)
    rays = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    inside = middle + (circle_radius - 0.022) * rays
    outside = middle + (circle_radius + 0.022) * rays
    is_shown = ((inside > 1) & (inside < [99, 79])).all(axis=1)
    assert is_shown.sum() > 300
    colors = [colors_at(scene, points[is_shown][::2])[:, 0] for points in (inside, outside)]
    np.testing.assert_array_equal(colors, [0 * colors[0], 0 * colors[1] + 1])


@pytest.mark.parametrize(
    ("center", "radius", "focus", "start_radius"),
    [
        ((0, 0), 2, (0, 0), 0),
        ((1, 0), 3, (-1, 1), 0.5),
        ((0, 1), 2, (1, 2.7), 0.01),
        ((2, 0), 2, (-1, -1), 0.5),
        ((-4, 1), 0.5, (3, 0), 0.1),
    ],
)
def test_the_bound_on_radii_holds(center, radius, focus, start_radius):
    box = np.array([[-5.0, -4.0], [9.0, -4.0], [9.0, 3.0], [-5.0, 3.0]])
    inside = np.random.default_rng(0).uniform([-5, -4], [9, 3], (500, 2))
    points = np.concatenate([box, inside])
    circles = circles_of(
        RadialGradient((), "pad", np.eye(3), center, float(radius), focus, float(start_radius))
    )
    # The circle of position t through a point v from the focus: |v - t axis| = r0 + t growth.
    growth, axis, vectors = radius - start_radius, np.subtract(center, focus), points - focus
    largest = 0.0
    for vector in vectors:
        polynomial = [
            axis @ axis - growth**2,
            -2 * (vector @ axis + start_radius * growth),
            vector @ vector - start_radius**2,
        ]
        positions = np.roots(polynomial)
        radii = start_radius + positions[np.isreal(positions)].real * growth
        largest = max(largest, radii.max(initial=0.0))
    bound = circles.largest_radius(1e9, box)
    assert largest <= bound * (1 + 1e-9)
    if np.hypot(*axis) < growth:
        assert largest == pytest.approx(bound)
    for position in (0.0, 0.1, 0.9, 2.5):
        wanted = min(start_radius + position * growth, bound)
        assert circles.largest_radius(position, box) == pytest.approx(wanted)


def test_start_circles_and_cones():
    head = '<radialGradient id="g" gradientUnits="userSpaceOnUse" cx="50" cy="40"'
    ring = read(f'{head} r="30" fr="10">{STOPS}</radialGradient>')
    distance = np.hypot(*(POINTS - [50, 40]).T)
    np.testing.assert_allclose(grey(ring), np.clip((distance - 10) / 20, 0, 1), atol=3e-3)
    # A gradient from the larger circle to the smaller one has the same colours in reverse.
    shrinking = read(f'{head} r="10" fr="30">{STOPS}</radialGradient>')
    np.testing.assert_allclose(grey(shrinking), 1 - np.clip((distance - 10) / 20, 0, 1), atol=3e-3)
    cone = read(f'{head} r="10" fx="10">{STOPS}</radialGradient>')
    # Nothing is painted outside the cone with its apex at (10, 40) around the circle.
    assert colors_at(cone, [[50.3, 75.2], [5.1, 40.2]]).tolist() == [[1, 1, 1]] * 2
    # On the axis of the cone, the circle of position t begins at x = 10 + 30 t.
    np.testing.assert_allclose(
        colors_at(cone, [[25.01, 40.02], [31.03, 40.02]])[:, 0], [0.5, 0.7], atol=3e-3
    )


@pytest.mark.parametrize("spread", SPREADS)
def test_circles_of_the_same_radius_shift_along_their_axis(spread):
    gradient = (
        '<radialGradient id="g" gradientUnits="userSpaceOnUse" cx="62" cy="49" r="30" fr="30" '
        f'fx="38" fy="31" spreadMethod="{spread}">{STOPS}</radialGradient>'
    )
    # Circles of radius 30 move along an axis of length 30. Of the two circles through a point, the
    # one of larger position counts.
    along, across = ((POINTS - [38, 31]) @ np.array([[0.8, -0.6], [0.6, 0.8]])).T
    is_inside = np.abs(across) < 30
    t = (along + np.sqrt(np.where(is_inside, 900 - across**2, 0.0))) / 30
    wanted = np.where(is_inside, SPREADS[spread](t), 1.0)
    # Points are left out near jumps, and near the sides, where circles of all colours meet.
    is_smooth = (np.abs((t + 0.5) % 1 - 0.5) > 5e-3) & (np.abs(np.abs(across) - 30) > 0.5)
    assert 5 < (is_smooth & is_inside).sum() < 40
    scene = read(gradient)
    np.testing.assert_allclose(grey(scene)[is_smooth], wanted[is_smooth], atol=1e-2)


@pytest.mark.parametrize("spread", ("repeat", "reflect"))
def test_gradients_repeat_inside_of_their_start_circle(spread):
    gradient = (
        '<radialGradient id="g" gradientUnits="userSpaceOnUse" cx="50" cy="40" r="35" fr="20" '
        f'spreadMethod="{spread}">{STOPS}</radialGradient>'
    )
    t = (np.hypot(*(POINTS - [50, 40]).T) - 20) / 15
    is_smooth = np.abs((t + 0.5) % 1 - 0.5) > 5e-3
    assert (is_smooth & (t < 0)).sum() > 3
    wanted = SPREADS[spread](t)
    np.testing.assert_allclose(grey(read(gradient))[is_smooth], wanted[is_smooth], atol=5e-3)


def test_stops_by_hand():
    stops = (
        '<stop offset="20%" stop-color="red"/><stop offset=".1" stop-color="lime"/>'
        '<stop offset=".5" stop-color="blue" stop-opacity=".5"/><stop offset="2" color="red" '
        'stop-color="currentColor"/>'
    )
    scene = read(f'<linearGradient id="g">{stops}</linearGradient>')
    # A decreasing offset is raised to the offset before it: red up to 20 %, and lime after it.
    colors = colors_at(scene, [[10.1, 33.3], [20.1, 33.3], [50, 33.3], [99.9, 33.3]])
    wanted = [[1, 0, 0], [0, 1, 0], [0.5, 0.5, 1], [1, 0, 0]]
    np.testing.assert_allclose(colors, wanted, atol=1e-2)


@pytest.mark.parametrize("fades", (False, True))
def test_a_half_that_is_transparent_paints_nothing(fades):
    first, second = ("0", "1") if fades else ("0.5", "0.5")
    axis = 'x1="0.5" x2="1"' if fades else ""
    gradient = (
        f'<linearGradient id="g" {axis}><stop offset="{first}" stop-color="red" stop-opacity="0"/>'
        f'<stop offset="{second}" stop-color="red"/></linearGradient>'
    )
    x = np.array([0.1, 0.45, 0.55, 0.75, 0.95])
    colors = colors_at(read(gradient), np.stack([100 * x, np.full(5, 33.3)], 1))
    alpha = np.clip((x - 0.5) / 0.5, 0, 1) if fades else x > 0.5
    np.testing.assert_allclose(colors[:, 1], 1 - alpha, atol=1e-2)


def test_gradients_inherit_from_each_other():
    first = f'<linearGradient id="f" x2="0" y2="1">{STOPS}</linearGradient>'
    np.testing.assert_allclose(
        grey(read(first + '<linearGradient id="g" href="#f"/>')), POINTS[:, 1] / 80, atol=2e-4
    )
    # Geometry is inherited only from gradients of the same kind.
    radial = read(first + '<radialGradient id="g" href="#f"/>')
    centre = colors_at(radial, [[50.1, 40.2], [2, 2]])[:, 0]
    assert centre[0] < 0.02 and centre[1] == 1


def test_gradients_that_paint_nothing_or_one_colour():
    for gradient, wanted in (
        ('<linearGradient id="g"/>', [1, 1, 1]),
        ('<linearGradient id="g"><stop stop-color="red"/></linearGradient>', [1, 0, 0]),
        (f'<linearGradient id="g" x2="0">{STOPS}</linearGradient>', [1, 1, 1]),
        (f'<radialGradient id="g" r="0">{STOPS}</radialGradient>', [1, 1, 1]),
        # The start circle and the end circle are the same: SVG 2, section 14.2.3.2.
        (f'<radialGradient id="g" fr="0.5">{STOPS}</radialGradient>', [1, 1, 1]),
    ):
        assert colors_at(read(gradient), [[33.3, 22.2]]).tolist() == [wanted]
    with pytest.warns(UserWarning, match=r"fill of <rect> \(line 1: refers to no paint"):
        assert read("").triangles.size == 0


def test_a_gradient_on_a_shape_without_area_is_not_applied():
    gradient = f'<linearGradient id="g">{STOPS}</linearGradient>'
    line = '<line x1="10" y1="40" x2="90" y2="40" stroke-width="9" stroke="url(#g) red"/>'
    assert colors_at(read(gradient, line), [[50.1, 41.2]]).tolist() == [[1, 0, 0]]


def test_a_pattern_on_a_shape_without_area_is_not_applied_either():
    """SVG defines that such a shape has the fallback colour, so reading it gives no warning."""
    line = '<line x2="90" y1="40" y2="40" stroke="url(#p) lime" stroke-width="9"/>'
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scene = read('<pattern id="p" width="1" height="1"/>', line)
    assert colors_at(scene, [[50.03, 41.07]]).tolist() == [[0, 1, 0]]
    for pattern in (
        "<pattern id='p' patternUnits='userSpaceOnUse'/>",
        "<pattern id='p' href='#q'/>",
    ):
        with pytest.warns(UserWarning, match="stroke of <line> .*patterns are not drawn"):
            read(pattern, line)


def test_strokes_and_opacity_of_gradients():
    gradient = f'<linearGradient id="g" gradientUnits="userSpaceOnUse">{STOPS}</linearGradient>'
    line = (
        '<line y1="40" x2="100" y2="40.001" stroke-width="60" stroke="url(#g)" '
        'stroke-opacity=".5" opacity=".5"/>'
    )
    colors = colors_at(read(gradient, line), [[25.02, 33.3], [75.03, 44.1]])[:, 0]
    np.testing.assert_allclose(colors, [0.75 + 0.25 * 0.25, 0.75 + 0.25 * 0.75], atol=1e-3)


def test_gradients_that_repeat_without_end_are_refused():
    gradient = (
        '<linearGradient id="g" gradientUnits="userSpaceOnUse" x2="1e-9" spreadMethod="repeat">'
        f"{STOPS}</linearGradient>"
    )
    with pytest.raises(ValueError, match="vertices of regions to clip and cut; at most"):
        read(gradient)


@pytest.mark.parametrize("spread", SPREADS)
def test_the_border_before_the_first_stop_is_painted(spread):
    """The first strip begins beside the first stop, and this stop is at the border of the shape."""
    gradient = f'<linearGradient id="g" spreadMethod="{spread}">{STOPS}</linearGradient>'
    scene = parse_svg(
        f'<svg xmlns="http://www.w3.org/2000/svg" width="2000" height="8">{gradient}'
        '<rect width="2000" height="8" fill="red"/>'
        '<rect width="2000" height="8" fill="url(#g)"/></svg>'
    )
    wanted = 1.0 if spread == "repeat" else 0.0
    np.testing.assert_allclose(colors_at(scene, [[0.01, 3.07]])[0], wanted, atol=1e-4)


def test_concentric_circles_of_almost_one_radius():
    gradient = f'<radialGradient id="g" r="0.5" fr="0.4999">{STOPS}</radialGradient>'
    assert colors_at(read(gradient), [[50.1, 40.2], [2, 2]])[:, 0].tolist() == [0, 1]


def test_a_single_piece_does_not_paint_beyond_the_cone():
    """The border of the cone of circles is a horizontal line through the middle of the shape."""
    angle = math.degrees(math.asin(100 / 500))
    gradient = (
        '<radialGradient id="g" gradientUnits="userSpaceOnUse" fx="0" fy="0" cx="500" cy="0" '
        f'r="100" gradientTransform="translate(-200 40) rotate({angle})"><stop offset=".4"/>'
        '<stop offset=".6"/></radialGradient>'
    )
    scene = read(gradient, '<rect x="50" y="39.5" width="1" height="1" fill="url(#g)"/>')
    colors = colors_at(scene, [[50.51, 39.8], [50.51, 40.2]])[:, 0]
    np.testing.assert_array_equal(colors, [1, 0])


@pytest.mark.parametrize(("shift", "start_radius"), [(27, 0), (0, 24), (5, 24)])
def test_colours_are_accurate_where_circles_lie_close_together(shift, start_radius):
    gradient = (
        f'<radialGradient id="g" gradientUnits="userSpaceOnUse" cx="50" cy="40" r="30" '
        f'fx="{50 + shift}" fy="40" fr="{start_radius}">{STOPS}</radialGradient>'
    )
    rng = np.random.default_rng(0)
    t, angle = rng.uniform(0.02, 0.98, 300), rng.uniform(-0.2, 0.2, 300)
    radius = start_radius + t * (30 - start_radius)
    points = np.stack([50 + (1 - t) * shift, 0 * t + 40], axis=1)
    points += radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    colors = colors_at(read(gradient, height=1600, width=2000), 20 * points)[:, 0]
    np.testing.assert_allclose(colors, t, atol=1.2e-3)
