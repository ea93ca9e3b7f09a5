"""Dialect `course`: every peculiarity, worked by hand, and one file read in both dialects."""

from typing import Any

import numpy as np
import pytest

from softras2d.io.svg.reading.reader import parse_svg

from ....cases.drawings import corners_of
from ....cases.work import count_calls

SIZE = 'width="100" height="80"'
ONE_TO_ONE = np.eye(3)


def read(
    body: str,
    root: str = SIZE,
    *,
    dialect: str = "course",
    transform: Any = ONE_TO_ONE,
    frame: bool | None = False,
    **options: Any,
):
    return parse_svg(
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="x" {root}>{body}</svg>',
        dialect=dialect,
        transform=transform,
        frame=frame if dialect == "course" else None,
        **options,
    )


def colors(scene):
    return np.asarray(scene.colors)[:, 0].tolist()


def boxes(scene):
    """The rectangles (x0, y0, x1, y1) of whole pixels in a scene, which are two triangles each."""
    quads = corners_of(scene).reshape(-1, 6, 2)
    return np.concatenate([quads.min(axis=1), quads.max(axis=1)], axis=1).tolist()


def hex_colors(scene):
    return ["".join(f"{round(255 * c):02x}" for c in color) for color in colors(scene)]


@pytest.mark.parametrize(
    ("paint", "code"),
    [
        ("#ff8000", "ff8000"),
        ("ff8000", "ff8000"),
        ("#f00", "000f00"),  # there is no short form
        ("none", "000000"),  # is black, and does not mean "no fill"
        ("blue", "00000b"),  # b is a hexadecimal digit, l is not
        ("red", "000000"),
        ("rgb(1,2,3)", "000000"),
        ("#12zz", "000012"),
        ("#", "000000"),
        ("", "000000"),
        (None, "000000"),
    ],
)
def test_fill_is_read_as_hex_digits(paint, code):
    attribute = "" if paint is None else f'fill="{paint}"'
    assert hex_colors(read(f'<rect width="5" height="5" {attribute}/>')) == [code] * 2


def test_channels_are_float32_of_bytes():
    scene = read("".join(f'<rect fill="#{byte:02x}0000"/>' for byte in range(256)))
    reds = np.asarray(scene.colors)[::2, 0, 0]
    np.testing.assert_array_equal(reds, (np.arange(256) / 255).astype(np.float32))


def test_style_is_not_inherited_but_transform_is():
    body = (
        '<g fill="#ff0000" stroke="#00ff00" transform="translate(10 20)" opacity=".5" '
        'style="fill:red" display="none"><rect width="5" height="5" style="fill:red"/></g>'
    )
    scene = read(body)
    assert hex_colors(scene) == ["000000"] * 2
    assert corners_of(scene).reshape(-1, 2).max(axis=0).tolist() == [15, 25]


def test_root_attributes_but_size_are_ignored():
    plain = read('<rect width="5" height="5"/>', SIZE, transform=None)
    other = read(
        '<rect width="5" height="5"/>',
        'width="100px" height="80mm" viewBox="0 0 1 1" x="9" y="9" preserveAspectRatio="bad" '
        'transform="scale(9 9)" fill="red"',
        transform=None,
    )
    np.testing.assert_array_equal(corners_of(plain), corners_of(other))


def test_the_drawing_is_scaled_and_centred():
    # The scale is 100 / 120. The size of the canvas is the size that the file gives.
    scene = read('<rect width="100" height="80"/>', 'width="100" height="100"', transform=None)
    corners = corners_of(scene).reshape(-1, 2)
    low, high = corners.min(axis=0), corners.max(axis=0)
    np.testing.assert_allclose(low, [50 / 6, 50 / 6], rtol=1e-6)
    np.testing.assert_allclose(high, [50 + 250 / 6, 50 + 150 / 6], rtol=1e-6)
    wide = read('<rect width="100" height="80"/>', transform=None, height=600, width=800)
    k = 600 / (1.2 * 100)
    np.testing.assert_allclose(
        corners_of(wide).reshape(-1, 2).min(axis=0), [400 - 50 * k, 300 - 40 * k]
    )


def test_a_size_is_needed_for_the_view():
    for root in ("", 'viewBox="0 0 5 5"', 'width="0" height="0"'):
        with pytest.raises(ValueError, match="width and height"):
            read("", root, transform=None, height=5, width=5)
    assert read("", "", height=5, width=5).triangles.shape == (0, 3)


def test_rect_is_two_triangles():
    scene = read('<rect x="1" y="2" width="3" height="4" fill="#ff0000"/>')
    # Corners are (top left, top right, bottom left), (bottom left, top right, bottom right).
    wanted = [[[1, 2], [4, 2], [1, 6]], [[1, 6], [4, 2], [4, 6]]]
    assert corners_of(scene).tolist() == wanted


def test_a_rect_without_size_is_a_point():
    assert boxes(read('<rect x="3.7" y="5.2" fill="#ff0000"/>')) == [[3, 5, 4, 6]]
    assert boxes(read('<rect x="3.7" y="5.2" stroke="#ff0000"/>')) == [[3, 5, 4, 6]]
    assert boxes(read('<rect x="-0.5" y="5"/><rect x="100" y="5"/><rect x="5" y="80"/>')) == []
    # With one of width and height, it is a rectangle without area.
    flat = corners_of(read('<rect x="3" y="5" width="4"/>'))
    assert flat.shape == (2, 3, 2) and (flat[..., 1] == 5).all()
    # The transform moves the point.
    moved = read('<rect x="1" y="1" transform="rotate(90) translate(3 -9)"/>')
    assert boxes(moved) == [[8, 4, 9, 5]]


def test_stroke_is_one_pixel_whatever_its_width():
    line = '<line x1="1.5" y1="2.5" x2="4.5" y2="2.5" {}/>'
    assert boxes(read(line.format('stroke="#ff0000" stroke-width="9"'))) == [[1, 2, 5, 3]]
    assert read(line.format("")).triangles.size == 0
    # Any value of `stroke` draws the line, and `none` is black.
    scene = read(line.format('stroke="none"'))
    assert boxes(scene) == [[1, 2, 5, 3]] and hex_colors(scene) == ["000000"] * 2


def test_polyline_is_never_filled_and_black_without_stroke():
    scene = read('<polyline points="1.5,2.5 4.5,2.5 4.5,5.5" fill="#ff0000"/>')
    assert boxes(scene) == [[1, 2, 5, 3], [4, 2, 5, 6]]
    assert hex_colors(scene) == ["000000"] * 4
    assert (
        hex_colors(read('<polyline points="1.5,2.5 4.5,2.5" stroke="#00ff00"/>')) == ["00ff00"] * 2
    )
    assert read('<polyline points="1.5,2.5"/>').triangles.size == 0


def test_polygon_is_filled_by_ears_and_outlined():
    scene = read('<polygon points="1,1 9,1 9,9 1,9" fill="#ff0000" stroke="#0000ff"/>')
    assert hex_colors(scene)[:2] == ["ff0000"] * 2
    assert set(hex_colors(scene)[2:]) == {"0000ff"}
    # Ears are in the course's order: (last, first, second), then the rest.
    assert corners_of(scene)[:2].tolist() == [[[1, 9], [1, 1], [9, 1]], [[9, 1], [9, 9], [1, 9]]]
    assert read('<polygon points="1,1 9,1"/>').triangles.size == 0
    assert len(boxes(read('<polygon points="1,1 9,1" stroke="#000000"/>'))) == 2
    # Fill rules are ignored: a bow tie is drawn by its ears.
    bow = read('<polygon points="0,0 2,2 2,0 0,2" fill-rule="evenodd"/>')
    assert corners_of(bow).tolist() == [[[0, 2], [2, 0], [2, 2]]]


def test_rect_outline_runs_around():
    scene = read('<rect x="1.5" y="1.5" width="4" height="3" stroke="#ff0000"/>')
    assert boxes(scene)[1:] == [[1, 1, 6, 2], [5, 1, 6, 5], [1, 4, 6, 5], [1, 1, 2, 5]]


def test_missing_attributes_are_zero():
    assert boxes(read('<line x2="3.5" stroke="#ff0000"/>')) == [[0, 0, 4, 1]]
    assert boxes(read("<rect/>")) == [[0, 0, 1, 1]]


def test_numbers_are_leading_floats_in_float32():
    scene = read('<rect x="0.1px" y="1e0abc" width="3mm" height="4%"/>')
    corners = corners_of(scene).reshape(-1, 2)
    low, high = corners.min(axis=0), corners.max(axis=0)
    assert low.tolist() == [np.float32(0.1), 1]
    assert high.tolist() == [np.float32(float(np.float32(0.1)) + 3), 5]


def test_vertices_are_mapped_in_float64_from_float32():
    scene = read(
        '<polygon points="16777217,0 16777219,0 16777219,5"/>',
        transform=[[1, 0, -16777216], [0, 1, 0], [0, 0, 1]],
    )
    # In float32, 16777217 and 16777219 round to even: 16777216 and 16777220.
    assert sorted(set(corners_of(scene)[..., 0].ravel().tolist())) == [0, 4]


def test_transforms_with_commas_and_blanks():
    with pytest.warns(UserWarning, match="transform ' scale'"):
        scene = read('<rect width="5" height="5" transform="translate(10,20)  scale(2 2)"/>')
    assert corners_of(scene).reshape(-1, 2).max(axis=0).tolist() == [15, 5]
    scene = read('<rect width="5" height="5" transform="scale(2)"/>')
    assert corners_of(scene).reshape(-1, 2).max(axis=0).tolist() == [10, 5]


def test_unknown_elements_are_skipped_with_their_subtree():
    body = (
        '<circle r="3"/><defs><rect width="5" height="5"/></defs><svg><rect/></svg>'
        '<a><rect width="5" height="5"/></a><title/><metadata><rect/></metadata><x:y><rect/></x:y>'
    )
    with pytest.warns(UserWarning, match=r"a \(1\), circle \(1\), defs \(1\), svg \(1\)\.$"):
        assert read(body).triangles.size == 0


def test_colortri_ignores_alpha():
    body = '<colortri points="{}" colors="1 0 0 .5 0 1 0 0 0 0 1.5 9"/>'
    scene = read(body.format("0 0 9 0 0 9"))
    # Alpha is read and dropped; colours are not clamped.
    assert scene.colors.tolist() == [[[1, 0, 0], [0, 1, 0], [0, 0, 1.5]]]
    with pytest.raises(ValueError, match=r"<colortri> points: expected 6"):
        read(body.format("0,0 9,0 0,9"))


def test_opacity_is_used_unless_switched_off():
    body = (
        '<rect width="5" height="5" fill="#ff0000" fill-opacity=".5" opacity=".1"/>'
        '<line x2="3.5" stroke="#000000" stroke-opacity="0.25"/>'
    )
    scene = read(body)
    assert sorted(set(np.asarray(scene.colors)[..., 3].ravel().tolist())) == [0.25, 0.5]
    assert read(body, opacity=False).colors.shape[-1] == 3


def test_translucent_pixels_are_covered_once():
    scene = read('<line x1=".5" y1=".5" x2="4.5" y2=".5" stroke="#000000" stroke-opacity=".5"/>')
    assert corners_of(scene).shape == (4, 3, 2)
    a, b = np.diff(corners_of(scene).astype(np.float64), axis=1).transpose(1, 0, 2)
    assert np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum() / 2 == pytest.approx(5, rel=1e-6)


def test_the_frame_is_black_and_last():
    """The frame is mapped like the drawing, and its corners are moved by a pixel."""
    drawn = read(
        "", frame=None, transform=[[1, 0, 10.5], [0, 1, 10.5], [0, 0, 1]], height=99, width=200
    )
    # The corners are (9.5, 11.5), (111.5, 11.5), (9.5, 89.5) and (111.5, 89.5).
    assert boxes(drawn) == [
        [9, 11, 112, 12], [9, 11, 10, 90], [111, 11, 112, 90], [9, 89, 112, 90],
    ]  # fmt: skip
    assert set(hex_colors(drawn)) == {"000000"}
    assert read("", frame=False).triangles.size == 0
    last = read('<rect width="5" height="5" fill="#ff0000"/>', frame=True)
    assert hex_colors(last)[:2] == ["ff0000"] * 2 and hex_colors(last)[-1] == "000000"


def test_a_frame_with_a_corner_at_infinity_is_refused():
    # The right side of the drawing, x = 100, is where w is 0.
    perspective = [[1, 0, 0], [0, 1, 0], [-0.01, 0, 1]]
    body = '\n<polygon points="0,0 5,5 0,5"/>\n'
    with pytest.raises(ValueError, match="infinity") as caught:
        read(body, transform=perspective, frame=True, height=80, width=100)
    assert str(caught.value) == (
        "<svg>:3: <svg> cannot be framed: `transform` sends a point to infinity or behind it "
        "(w <= 0)."
    )
    assert len(read(body, transform=perspective, height=80, width=100).triangles) == 1


def test_order_of_kinds_is_that_of_the_file():
    body = (
        '<line x2="3.5" stroke="#000001"/><rect width="5" height="5" fill="#000002"/>'
        '<rect fill="#000003"/><polygon points="0,0 9,0 9,9" fill="#000004"/>'
        '<line x2="3.5" stroke="#000005"/><colortri points="0 0 9 0 0 9" '
        f'colors="{"0 0 .025 1 " * 3}"/><polyline points="0,0 3,0" stroke="#000007"/>'
    )
    order = [int(code, 16) for code in hex_colors(read(body))]
    assert order == sorted(order) and set(order) == set(range(1, 8))


def test_one_file_differs_between_the_dialects():
    body = (
        '<rect width="10" height="10" fill="none"/><g fill="#ff0000" transform="translate(20,0)">'
        '<rect width="10" height="10" fill="#f00" stroke="none"/></g>'
        '<polyline points="0,50 20,50 20,70" stroke-width="4"/>'
    )
    course, svg = read(body), read(body, dialect="svg")
    # In the course's dialect: a black shape, a moved one in 0x000f00 with a black outline, and an
    # open black chain.
    assert hex_colors(course)[:2] == ["000000"] * 2
    assert hex_colors(course)[2:4] == ["000f00"] * 2
    assert set(hex_colors(course)[4:]) == {"000000"}
    # In the dialect `svg`: nothing, a red shape at x = 20, and a filled triangle.
    assert hex_colors(svg) == ["ff0000"] * 2 + ["000000"]
    assert corners_of(svg)[0, 0].tolist() == [20, 0]


def test_large_polygons_that_cross_themselves_give_a_warning():
    rng = np.random.default_rng(0)
    steps = rng.normal(size=(1200, 2)).cumsum(axis=0)
    points = " ".join(f"{x:.4f},{y:.4f}" for x, y in steps.tolist())
    with pytest.warns(UserWarning, match="too large to be clipped, filled nonzero: 1"):
        assert read(f'<polygon points="{points}"/>').triangles.shape[0] > 0


def outlined_polygons(count: int) -> str:
    """Pentagons with outlines, some of which cross themselves."""
    rng = np.random.default_rng(0)
    lines = []
    for _ in range(count):
        points = (rng.random(2) * 900 + rng.random((5, 2)) * 40).round(2)
        text = " ".join(f"{x},{y}" for x, y in points.tolist())
        lines.append(f'<polygon points="{text}" fill="#ff0000" stroke="#000000"/>')
    return "\n".join(lines)


def test_work_is_linear_in_the_number_of_outlined_polygons():
    few, many = (
        count_calls(lambda n=n: read(outlined_polygons(n), 'width="1000" height="1000"'))
        for n in (100, 1_000)
    )
    assert many < 12 * few
