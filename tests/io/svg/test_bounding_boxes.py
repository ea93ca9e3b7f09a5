"""Bounding boxes of elements and strokes, and the viewports and conditions on which they depend."""

import numpy as np
import pytest

from softras2d.io.svg.reading.reader import parse_svg

from ...cases.drawings import body_colors, colors_at

WHITE, BLACK = [1, 1, 1], [0, 0, 0]

LEFT_HALF = (
    '<clipPath id="c" clipPathUnits="objectBoundingBox"><rect width=".5" height="1"/></clipPath>'
)


@pytest.mark.parametrize(
    "element",
    [
        '<rect width="40" height="40" clip-path="url(#c)"/>',
        '<g clip-path="url(#c)"><svg width="40" height="40" viewBox="0 0 4 4">'
        '<rect width="4" height="4"/></svg></g>',
        '<svg width="40" height="40" viewBox="0 0 4 4" clip-path="url(#c)">'
        '<rect width="100%" height="4"/></svg>',
        '<symbol id="s" viewBox="0 0 4 4"><rect width="4" height="4"/></symbol>'
        '<use href="#s" width="40" height="40" clip-path="url(#c)"/>',
        '<symbol id="s" viewBox="0 0 4 4" clip-path="url(#c)"><rect width="4" height="4"/></symbol>'
        '<use href="#s" width="40" height="40"/>',
        '<g clip-path="url(#c)"><switch><rect width="40" height="40"/>'
        '<rect width="400" height="400"/></switch></g>',
        '<g clip-path="url(#c)"><rect width="40" height="40"/>'
        '<rect width="400" height="400" systemLanguage="de"/></g>',
        '<g clip-path="url(#c)"><symbol><rect width="400" height="400"/></symbol>'
        '<rect width="40" height="40"/></g>',
    ],
    ids=[
        "rect", "svg-in-g", "svg", "use-of-symbol", "symbol", "switch", "language", "unused-symbol",
    ],
)  # fmt: skip
def test_the_box_of_what_is_drawn(element):
    """Each element is a square of 40 px, and a clip path shows the left half of its box."""
    result = body_colors(LEFT_HALF + element, [5, 5], [15, 35], [25, 5], [45, 5])
    np.testing.assert_allclose(result, [BLACK, BLACK, WHITE, WHITE])


def test_a_nested_viewport_turns_about_its_own_center():
    body = (
        '<svg x="20" y="20" width="40" height="40" viewBox="0 0 4 4" '
        'style="transform-box:fill-box;transform-origin:center;transform:rotate(180deg)">'
        '<rect width="4" height="4" fill="red"/><rect width="2" height="4"/></svg>'
    )
    result = body_colors(body, [25, 30], [55, 30], [65, 30])
    np.testing.assert_allclose(result, [[1, 0, 0], BLACK, WHITE])


@pytest.mark.parametrize(
    "attributes",
    ['transform-box="fill-box" transform="rotate(90)"',
     'transform-box="fill-box" transform="rotate(90)" transform-origin="0 0"',
     'transform-box="fill-box" transform="rotate(90)" transform-origin="top left"',
     'style="transform-box: fill-box; transform: rotate(90deg)"',
     'style="transform-box: fill-box; rotate: 90deg"'],
)  # fmt: skip
def test_the_initial_origin_is_the_corner_of_the_box(attributes):
    """The rectangle turns about its corner at (50, 20), to the left of it."""
    body = f'<rect x="50" y="20" width="30" height="10" {attributes}/>'
    result = body_colors(body, [45, 45], [65, 25], [55, 45])
    np.testing.assert_allclose(result, [BLACK, WHITE, WHITE])


CURVES = {
    # Each has the box from (0.1, 0.2) to (0.7, 0.8), and its bottom inside of a curve.
    "clockwise": '<path d="M.1 .5V.2H.7L.69544233 .55209445A.3 .3 15 0 1 .1 .5"/>',
    "counterclockwise": '<path d="M.1 .5A.3 .3 15 0 0 .69544233 .55209445L.7 .2H.1Z"/>',
    "quadratic": '<path d="M.1 .4V.2H.7Q.4 1.2898979486 .1 .4"/>',
    "cubic": '<path d="M.1 .2H.7C.7 1 .1 1 .1 .2"/>',
}


@pytest.mark.parametrize("curve", CURVES.values(), ids=CURVES)
@pytest.mark.parametrize("units", ["viewBox", "group", "caller"])
def test_the_box_of_a_curve_is_exact_in_any_units(curve, units):
    """A unit is 1000 pixels, and a clip path shows the lower half of the box."""
    clip = (
        '<clipPath id="c" clipPathUnits="objectBoundingBox"><rect y=".5" width="1" height=".5"/>'
        "</clipPath>"
    )
    body = f'{clip}<g clip-path="url(#c)">{curve}</g>'
    head = '<svg xmlns="http://www.w3.org/2000/svg" width="1000" height="1000"'
    if units == "viewBox":
        scene = parse_svg(f'{head} viewBox="0 0 1 1">{body}</svg>')
    elif units == "group":
        scene = parse_svg(f'{head}><g transform="scale(1000)">{body}</g></svg>')
    else:
        scene = parse_svg(f"{head}>{body}</svg>", transform=np.diag([1000.0, 1000.0, 1.0]))
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles)]
    assert corners[..., 1].min() == pytest.approx(500, abs=0.001)


def test_the_box_of_a_turned_image_has_four_corners():
    """The image is a square on its tip, from x = 10 to x = 50; the rect lies inside of its box."""
    body = (
        '<g clip-path="url(#c)"><image width="28.2843" height="28.2843" '
        'transform="translate(30 10) rotate(45)"/><rect x="26" y="20" width="6" height="8"/></g>'
    )
    with pytest.warns(UserWarning, match="image without href"):
        result = body_colors(LEFT_HALF + body, [26.5, 25], [29.5, 25], [31, 25])
    np.testing.assert_allclose(result, [BLACK, BLACK, WHITE])


def test_children_of_clip_paths_have_conditions():
    clip = (
        '<clipPath id="c"><rect width="90" height="70" systemLanguage="de"/>'
        '<rect width="80" height="60" requiredExtensions="x"/><rect width="10" height="10"/>'
        "</clipPath>"
    )
    body = f'{clip}<rect width="50" height="50" clip-path="url(#c)"/>'
    np.testing.assert_allclose(body_colors(body, [5, 5], [15, 15]), [BLACK, WHITE])


@pytest.mark.parametrize(
    "attributes, points",
    [
        ('transform="rotate(180)"', [[95, 95], [5, 5]]),
        ('transform="translate(50)" viewBox="0 0 50 50"', [[60, 10], [10, 10]]),
        ('transform="scale(.5)" transform-origin="0 0"', [[3, 3], [7, 7]]),
    ],
)
def test_the_transform_of_the_root_is_that_of_a_box_of_css(attributes, points):
    """By default, the root is transformed about its centre, in px and not in viewBox units."""
    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="100" height="100" {attributes}>'
    scene = parse_svg(f'{head}<rect width="10" height="10"/></svg>')
    np.testing.assert_allclose(colors_at(scene, np.add(points, 0.01)), [BLACK, WHITE])


@pytest.mark.parametrize("box", ["0 0 0 10", "0 0 10 0"])
def test_a_view_box_without_area_draws_nothing(box, recwarn):
    head = f'<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9" viewBox="{box}">'
    assert len(parse_svg(f'{head}<rect width="9" height="9"/></svg>').triangles) == 0
    nested = f'<svg viewBox="{box}"><rect width="9" height="9"/></svg>'
    np.testing.assert_allclose(body_colors(nested, [5, 5]), [WHITE])
    assert not recwarn.list


@pytest.mark.parametrize(
    "overflow, color", [("visible visible", BLACK), ("visible clip", BLACK), ("clip auto", WHITE)]
)
def test_the_first_keyword_of_overflow_decides_whether_a_viewport_clips(overflow, color):
    svg = f'<svg width="9" height="9" overflow="{overflow}"><rect width="20" height="9"/></svg>'
    np.testing.assert_allclose(body_colors(svg, [5, 5], [15, 5]), [BLACK, color])


def test_the_clipped_corner_of_a_miter_is_within_the_clip():
    """One corner of the cut miter reaches 22.4 pixels to the right of (40, 40)."""
    clip = '<clipPath id="c"><rect x="-99" y="-99" width="160" height="300"/></clipPath>'
    stroke = 'stroke="#000" stroke-width="20" stroke-linejoin="miter-clip" stroke-miterlimit="2"'
    line = f'<path d="M13.1672 26.5836 40 40 13.1673 26.5836" fill="none" {stroke} {{}}/>'
    points = [60.5, 40], [61.5, 40]
    np.testing.assert_allclose(body_colors(line.format(""), *points), [BLACK, BLACK])
    clipped = body_colors(clip + line.format('clip-path="url(#c)"'), *points)
    np.testing.assert_allclose(clipped, [BLACK, WHITE])


def test_the_clipped_corner_of_a_miter_counts_in_a_group_with_opacity():
    """Where this corner overlaps the rectangle, the group hides the red stroke below it."""
    stroke = 'stroke="red" stroke-width="20" stroke-linejoin="miter-clip" stroke-miterlimit="2"'
    line = f'<path d="M13.1672 26.5836 40 40 13.1673 26.5836" fill="none" {stroke}/>'
    body = f'<g opacity=".5">{line}<rect x="61" y="30" width="9" height="20"/></g>'
    np.testing.assert_allclose(body_colors(body, [61.5, 40]), [[0.5, 0.5, 0.5]])
