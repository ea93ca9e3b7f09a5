"""Dialect `svg`: the triangles and colours of each element, worked by hand."""

import warnings

import numpy as np
import pytest
import shapely

from softras2d.io.svg.reading.reader import parse_svg

from ....cases.drawings import corners_of

NS = 'xmlns="http://www.w3.org/2000/svg"'


def read(body, root='width="100" height="80"', **options):
    return parse_svg(f"<svg {NS} {root}>{body}</svg>", **options)


def shape(scene, index=slice(None)):
    return shapely.union_all(shapely.polygons(corners_of(scene)[index].astype(np.float64)))


def test_an_empty_drawing_is_white():
    scene = read("")
    assert scene.triangles.shape == (0, 3)
    assert scene.colors.shape == (0, 1, 3)
    assert np.asarray(scene.background).tolist() == [1, 1, 1]


def test_structure_is_the_smallest():
    flat = '<rect width="5" height="5" fill="red"/>'
    shaded = '<colortri points="0 0 9 0 0 9" colors="1 0 0 1 0 1 0 1 0 0 1 {}"/>'
    assert read(flat).colors.shape == (2, 1, 3)
    assert read(flat + shaded.format(1)).colors.shape == (3, 3, 3)
    assert read(flat + shaded.format(0.5)).colors.shape == (3, 3, 4)
    assert read(f'<g opacity=".5">{flat}</g>').colors.shape == (4, 1, 4)
    assert read(f'<g opacity=".5">{flat}</g>', opacity=False).colors.shape == (2, 1, 3)
    assert read(flat).uv is None


def test_fallbacks_are_skipped_with_their_content():
    shaded = '<colortri points="0 0 9 0 0 9" colors="1 0 0 1 0 1 0 1 0 0 1 1"/>'
    for fallback in (
        '<polygon data-fallback="1" points="0,0 9,0 0,9"/>',
        '<g data-fallback=""><rect width="5" height="5"/><circle r="1"/></g>',
        '<style data-fallback="1">rect { fill: red }</style>',
    ):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            scene = read(fallback + shaded + fallback)
        assert corners_of(scene).tolist() == [[[0, 0], [9, 0], [0, 9]]]


def test_basic_shapes_cover_their_areas():
    assert shape(read('<rect x="1" y="2" width="3" height="4"/>')).equals(shapely.box(1, 2, 4, 6))
    assert shape(read('<polygon points="0,0 9,0 9,9"/>')).area == 40.5
    assert shape(read('<polyline points="0,0 9,0 9,9"/>')).area == 40.5
    assert read('<polyline points="0,0 9,0 9,9" fill="none"/>').triangles.shape[0] == 0
    line = '<line x1="10" y1="10" x2="20" y2="10" stroke="red"/>'
    assert shape(read(line)).equals(shapely.box(10, 9.5, 20, 10.5))
    assert read(line.replace("stroke", "fill")).triangles.shape[0] == 0
    open_chain = '<polyline points="9,9 19,9 19,19" fill="none" stroke="red" stroke-width="2"/>'
    assert shape(read(open_chain)).area == pytest.approx(40)
    assert shape(read(open_chain.replace("polyline", "polygon"))).area > 55


def test_stroke_is_over_fill_and_later_over_earlier():
    scene = read(
        '<rect x="9" y="9" width="9" height="9" fill="red" stroke="blue"/>'
        '<rect width="1" height="1"/>'
    )
    colors = np.asarray(scene.colors)[:, 0].tolist()
    assert colors[:2] == [[1, 0, 0]] * 2
    assert all(color == [0, 0, 1] for color in colors[2:-2])
    assert colors[-2:] == [[0, 0, 0]] * 2


def test_invisible_elements_draw_nothing():
    for body in (
        '<rect width="0" height="5"/>', '<rect width="5"/>', '<polygon points=""/>', "<polygon/>",
        '<polygon points="1,1 2,2"/>', '<rect width="5" height="5" fill="none"/>',
        '<g display="none"><rect width="5" height="5"/><circle r="3"/></g>',
        '<g style="display:none"><rect width="5" height="5"/></g>',
        '<g visibility="hidden"><rect width="5" height="5" stroke="red"/></g>',
        '<g transform="scale(0)"><rect width="5" height="5" stroke="red"/></g>',
        '<defs><rect width="5" height="5"/><g/></defs>',
        "<title>t</title><desc/><metadata><x/></metadata>",
        '<line x1="3" y1="3" x2="3" y2="3" stroke="red"/>',
    ):  # fmt: skip
        assert read(body).triangles.shape[0] == 0, body


def test_a_root_that_is_not_displayed_draws_nothing():
    assert (
        read('<rect width="5" height="5"/>', 'width="9" height="9" display="none"').triangles.size
        == 0
    )


def test_units_and_percentages_by_hand():
    body = '<rect x="10%" y="10%" width="1in" height="50%"/>'
    assert shape(read(body)).equals(shapely.box(10, 8, 106, 48))
    inside = shape(read(body, 'viewBox="0 0 200 40" width="200" height="40"'))
    assert inside.equals(shapely.box(20, 4, 116, 24))
    # Percentages of stroke widths are of the viewport's diagonal over the square root of 2.
    bar = '<line x1="0" y1="20" x2="30" y2="20" stroke="red" stroke-width="10%"/>'
    assert shape(read(bar, 'width="70" height="10"')).area == pytest.approx(150)


def test_view_box_and_canvas_size_by_hand():
    body = '<rect x="5" y="6" width="5" height="20"/>'
    root = 'viewBox="5 6 10 20" width="60" height="40"'
    assert shape(read(body, root)).equals(shapely.box(20, 0, 30, 40))
    sliced = read(body, root + ' preserveAspectRatio="xMinYMax slice"')
    assert shape(sliced).bounds == (0, -80, 30, 40)
    assert shape(read(body, root, height=20, width=100)).equals(shapely.box(45, 0, 50, 20))
    assert shape(read(body, root + ' preserveAspectRatio="none"')).bounds == (0, 0, 30, 40)
    page = '<rect x="5" y="6" width="10" height="20"/>'
    for aspect in ("none", "xMinYMin slice"):
        scene = read(page, f'{root} preserveAspectRatio="{aspect}"')
        assert scene.background.tolist() == [0, 0, 0]
    # Without a viewBox, the size of the drawing serves as one, so another canvas size scales it.
    box = '<rect x="1" y="1" width="2" height="2"/>'
    scaled = read(box, 'width="10" height="10"', height=30, width=30)
    assert shape(scaled).equals(shapely.box(3, 3, 9, 9))


def test_fractional_sizes_do_not_stretch_the_drawing():
    body = '<rect x="100" y="100" width="1" height="1"/>'
    root = 'width="272.863px" height="300.1px"'
    assert shape(read(body, root)).equals(shapely.box(100, 100, 101, 101))
    assert shape(read(body, root, height=301, width=273)).equals(shapely.box(100, 100, 101, 101))


def test_transform_replaces_the_view():
    body = '<rect width="4" height="2"/>'
    root = 'viewBox="0 0 100 100" width="10" height="10"'
    moved = read(body, root, transform=[[2, 0, 5], [0, 3, 6], [0, 0, 1]])
    assert shape(moved).equals(shapely.box(5, 6, 13, 12))
    # Matrices are homogeneous: twice the matrix is the same map, and the third row divides.
    assert shape(read(body, root, transform=2 * np.eye(3))).equals(shapely.box(0, 0, 4, 2))
    shrunk = read(body, root, transform=[[1, 0, 0], [0, 1, 0], [0.25, 0, 1]])
    np.testing.assert_array_equal(
        corners_of(shrunk),
        np.array([[[0, 0], [2, 0], [2, 1]], [[0, 0], [2, 1], [0, 2]]], np.float32),
    )


def test_vertices_are_mapped_in_float64():
    rect = '<rect x="-16777216" y=".1" width="1" height="1"/>'
    body = f'<g transform="translate(16777216.25 0)">{rect}</g>'
    assert corners_of(read(body))[0, 0].tolist() == [0.25, np.float32(0.1)]


def test_nested_transforms_and_inherited_style():
    body = (
        '<g transform="translate(10 10)" fill="lime"><a transform="scale(2)" fill-opacity="1">'
        '<rect width="3" height="3"/></a></g>'
    )
    scene = read(body, f'width="99" height="99" fill="red" xmlns:svg="{NS[7:-1]}"')
    assert shape(scene).equals(shapely.box(10, 10, 16, 16))
    assert np.asarray(scene.colors)[:, 0].tolist() == [[0, 1, 0]] * 2


def test_the_transform_of_the_root_moves_its_content():
    # The translation is in user units, as it is for a group.
    scene = read('<rect width="1" height="1"/>', 'width="9" height="9" transform="translate(3 4)"')
    assert shape(scene).equals(shapely.box(3, 4, 4, 5))


def test_points_may_be_separated_in_any_way():
    for points in ("0,0 9,0 9,9", "0 0 9 0 9 9", "0,0,9,0,9,9", " 0 ,0\n9, 0\t9 9 ", "0-0 9+0 9 9"):
        assert shape(read(f'<polygon points="{points}"/>')).area == 40.5
    with pytest.warns(UserWarning, match="points of <polygon>.*odd number of coordinates"):
        assert shape(read('<polygon points="0,0 9,0 9,9 7"/>')).area == 40.5


def test_triangles_coloured_by_a_style_sheet():
    """Illustrator writes colours as classes in a style sheet."""
    scene = read(
        "<defs><style>.cls-1{fill:#0f0;}.cls-2,.cls-3{stroke-width:0}.cls-2{fill:#00f}</style></defs>"
        '<path class="cls-1" d="M0 0L9 0L0 9Z"/><polygon class="cls-2" points="9,0 9,9 0,9"/>'
    )
    assert np.asarray(scene.colors)[:, 0].tolist() == [[0, 1, 0], [0, 0, 1]]
    assert np.asarray(scene.positions)[np.asarray(scene.triangles)[0]].tolist() == [
        [0, 0], [9, 0], [0, 9],
    ]  # fmt: skip


def test_strokes_are_in_the_coordinates_of_their_element():
    """A scale along one axis widens only the strokes that run across this axis."""
    pen = 'stroke="red" stroke-width="2" fill="none" transform="scale(4 1)"'
    upright = read(f'<path d="M5 0V20" {pen}/>')
    assert shape(upright).symmetric_difference(shapely.box(16, 0, 24, 20)).area < 1e-3
    level = read(f'<path d="M0 10H5" {pen}/>')
    assert shape(level).symmetric_difference(shapely.box(0, 9, 20, 11)).area < 1e-3


def test_fill_rules_differ_in_a_star():
    star = '<polygon points="50,0 21,80 97,30 3,30 79,80" fill-rule="{}"/>'
    nonzero, evenodd = (shape(read(star.format(rule))) for rule in ("nonzero", "evenodd"))
    assert nonzero.contains(shapely.Point(50, 40))
    assert not evenodd.contains(shapely.Point(50, 40))
    assert nonzero.area > evenodd.area


def test_translucent_shapes_do_not_overlap_themselves():
    for body in (
        '<rect x="2" y="2" width="20" height="20" fill-opacity=".5"/>',
        '<polygon points="0,0 40,0 40,10 10,10 10,40 0,40" opacity=".5"/>',
        '<polyline points="10,10 40,10 40,40 20,0" fill="none" stroke="red" '
        'stroke-width="5" stroke-opacity=".5"/>',
        '<polygon points="10,10 40,10 40,40" fill="none" stroke="rgb(0 0 0 / 50%)" '
        'stroke-width="5" stroke-linejoin="round"/>',
    ):  # fmt: skip
        scene = read(body)
        outline = shape(scene)
        areas = shapely.area(shapely.polygons(corners_of(scene).astype(np.float64)))
        assert areas.sum() == pytest.approx(outline.area, rel=1e-5)
        assert set(np.asarray(scene.colors)[..., 3].ravel().tolist()) == {0.5}
        opaque = shape(read(body, opacity=False))
        assert opaque.symmetric_difference(outline).area < 1e-3


def test_a_translucent_triangle_is_not_divided():
    scene = read('<polygon points="1,1 9,1 1,9" fill-opacity="0.25"/>')
    np.testing.assert_array_equal(
        corners_of(scene), np.array([[[1, 1], [9, 1], [1, 9]]], np.float32)
    )
    assert np.asarray(scene.colors).tolist() == [[[0, 0, 0, 0.25]]]


def test_opacities_multiply():
    rect = '<rect width="5" height="5" fill="rgb(0 0 0/50%)" fill-opacity=".5"/>'
    body = f'<g opacity=".5"><g opacity=".5">{rect}</g></g>'
    assert np.asarray(read(body).colors)[0, 0, 3] == 0.0625


def test_a_first_rect_over_the_canvas_is_the_background():
    page = '<rect width="100" height="80" fill="#336699"/>'
    scene = read(page + '<rect width="3" height="3"/>')
    np.testing.assert_array_equal(scene.background, np.array([0.2, 0.4, 0.6], np.float32))
    assert scene.triangles.shape[0] == 2
    boxed = read(
        '<rect x="-5" y="-4" width="100%" height="100%" fill="red"/>',
        'viewBox="-5 -4 10 8" width="100" height="80"', height=160, width=200,
    )  # fmt: skip
    assert boxed.triangles.shape[0] == 0
    assert boxed.background.tolist() == [1, 0, 0]


@pytest.mark.parametrize(
    "body",
    [
        '<rect width="3" height="3"/><rect width="100" height="80" fill="red"/>',
        '<rect width="100" height="80" fill="red" fill-opacity=".5"/>',
        '<rect width="100" height="80" fill="red" stroke="blue"/>',
        '<rect width="100" height="79" fill="red"/>',
        '<rect width="101" height="80" fill="red"/>',
        '<g transform="rotate(3)"><rect width="100" height="80" fill="red"/></g>',
        '<polygon points="0,0 100,0 100,80 0,80" fill="red"/>',
    ],
)
def test_other_shapes_are_not_the_background(body):
    scene = read(body)
    assert scene.background.tolist() == [1, 1, 1]
    assert scene.triangles.shape[0] > 1


def test_a_page_in_a_wider_canvas_has_margins():
    scene = read('<rect width="100" height="80" fill="red"/>', height=80, width=200)
    assert scene.background.tolist() == [1, 1, 1]
    assert shape(scene).equals(shapely.box(50, 0, 150, 80))


def test_colours_are_decoded_to_linear_light():
    scene = read(
        '<rect width="100" height="80" fill="#808080"/><rect width="5" height="5" fill="#bc0a00"/>',
        linear=True,
    )
    gray = ((128 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(scene.background, [gray] * 3, rtol=1e-6)
    red = ((0xBC / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(
        np.asarray(scene.colors)[0, 0], [red, 10 / 255 / 12.92, 0], rtol=1e-6
    )


def test_colortri_has_corner_colours_and_opacity():
    scene = read(
        '<g opacity=".5" transform="translate(1 2)">'
        '<colortri points="0,0 9,0 0,9" colors="1 0 0 1 0 1.5 0 0.5 0 0 1 0" '
        'fill-opacity=".5"/></g>'
    )
    np.testing.assert_array_equal(
        corners_of(scene), np.array([[[1, 2], [10, 2], [1, 11]]], np.float32)
    )
    np.testing.assert_array_equal(
        scene.colors, np.array([[[1, 0, 0, 0.25], [0, 1.5, 0, 0.125], [0, 0, 1, 0]]], np.float32)
    )
    with pytest.raises(ValueError, match="alpha"):
        read('<colortri points="0 0 9 0 0 9" colors="1 0 0 2 0 1 0 1 0 0 1 1"/>')


def test_prefixed_elements_are_read():
    text = (
        '<s:svg xmlns:s="http://www.w3.org/2000/svg" width="9" height="9">'
        '<s:g fill="red"><s:rect width="3" height="3"/></s:g>'
        '<rect xmlns="urn:x" width="5"/></s:svg>'
    )
    assert parse_svg(text).triangles.shape[0] == 2


def test_the_namespace_of_an_element_decides_not_its_prefix():
    root = f'width="9" height="9" xmlns:svg="{NS[7:-1]}" xmlns:other="urn:x"'
    body = '<svg:g><svg:rect width="3" height="3"/></svg:g><other:rect width="5" height="5"/>'
    assert shape(read(body, root)).equals(shapely.box(0, 0, 3, 3))
    with pytest.warns(UserWarning, match=r"not drawn: <svg:text> \(line 1\)\.$"):
        read("<svg:text/>", root)


def test_a_foreign_default_namespace_is_not_svg():
    """Names without a prefix are in the default namespace, wherever it is declared."""
    rect = '<rect width="5" height="5"/>'
    assert read(f'<g xmlns="urn:x">{rect}</g>').triangles.size == 0
    mixed = f'<s:g xmlns="urn:x" xmlns:s="{NS[7:-1]}"><s:rect width="3" height="3"/>{rect}</s:g>'
    assert shape(read(mixed)).equals(shapely.box(0, 0, 3, 3))
    with pytest.raises(ValueError, match="must be <svg>"):
        parse_svg(f'<svg xmlns="urn:x" width="9" height="9">{rect}</svg>')


SHAPES_ON_PIXELS = (
    '<rect x="2" y="2" width="12" height="12" fill-opacity=".5"/>'
    '<polygon points="16,2 30,2 30,6 20,6 20,14 16,14" fill-opacity=".5"/>'
)


def test_no_sample_lies_on_an_inner_edge_of_a_translucent_shape():
    """A sample on an inner edge would be blended twice. Samples lie at odd eighths of a pixel."""
    corners = corners_of(read(SHAPES_ON_PIXELS, 'width="32" height="16"')).astype(np.float64)
    x, y = np.meshgrid((np.arange(4 * 32) + 0.5) / 4, (np.arange(4 * 16) + 0.5) / 4)
    samples = np.stack([x, y], axis=-1)[:, :, None]
    sides = np.roll(corners, -1, axis=1) - corners
    offsets = samples[..., None, :] - corners
    areas = sides[..., 0] * offsets[..., 1] - sides[..., 1] * offsets[..., 0]
    is_inside = (areas >= 0).all(axis=-1) | (areas <= 0).all(axis=-1)
    wanted = np.zeros((16, 32), int)
    wanted[2:14, 2:14] = wanted[2:14, 16:20] = wanted[2:6, 16:30] = 1
    np.testing.assert_array_equal(is_inside.sum(axis=-1), wanted.repeat(4, 0).repeat(4, 1))


@pytest.mark.slow
def test_a_translucent_shape_on_whole_pixels_shows_no_seam():
    import softras2d as sr

    scene = read(SHAPES_ON_PIXELS, 'width="32" height="16"')
    plan = sr.plan(scene, height=16, width=32, coverage=sr.Hard(samples=16))
    image = np.asarray(sr.render(scene, plan))
    wanted = np.ones((16, 32, 3))
    wanted[2:14, 2:14] = wanted[2:14, 16:20] = wanted[2:6, 16:30] = 0.5
    np.testing.assert_allclose(image, wanted, atol=1e-6)
