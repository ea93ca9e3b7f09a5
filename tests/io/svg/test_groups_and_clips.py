"""Opacity of groups, clip paths, references and viewports give the right colours off edges."""

import warnings

import numpy as np
import pytest

from softras2d.io import budget
from softras2d.io.budget import MAX_COPIES
from softras2d.io.svg.reading.reader import parse_svg

from ...cases.drawings import body_colors, corners_of, read_body

WHITE, RED, LIME, BLUE = [1, 1, 1], [1, 0, 0], [0, 1, 0], [0, 0, 1]


def half(color):
    return [(1 + channel) / 2 for channel in color]


def test_a_shape_with_opacity_is_composited_as_a_whole():
    """With `opacity`, the stroke hides the fill below it, although the result is translucent."""
    rect = '<rect x="20" y="20" width="40" height="40" fill="red" stroke="blue" stroke-width="10"'
    result = body_colors(f'{rect} opacity=".5"/>', [40, 40], [22, 40], [17, 40])
    np.testing.assert_allclose(result, [half(RED), half(BLUE), half(BLUE)])
    # With `stroke-opacity` instead, the fill shows through the stroke.
    result = body_colors(f'{rect} stroke-opacity=".5"/>', [22, 40], [17, 40])
    np.testing.assert_allclose(result, [[0.5, 0, 0.5], half(BLUE)])


def test_a_group_with_opacity_is_composited_as_a_whole():
    body = (
        '<g opacity=".5"><rect width="40" height="40" fill="red"/><circle cx="40" cy="40" r="20" '
        'fill="lime"/><path d="M35 35H90V45H35Z" fill="blue"/></g>'
    )
    result = body_colors(body, [10, 10], [30, 30], [38, 40], [80, 40], [50, 50], [90, 70])
    wanted = [half(RED), half(LIME), half(BLUE), half(BLUE), half(LIME), WHITE]
    np.testing.assert_allclose(result, wanted)


def test_translucent_members_that_overlap_are_exact():
    body = (
        '<g opacity=".5"><rect width="40" height="40" fill="red" fill-opacity=".5"/>'
        '<rect x="20" width="40" height="40" fill="lime" fill-opacity=".25"/>'
        '<rect x="30" width="4" height="40" fill="blue"/></g>'
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = body_colors(body, [10, 10], [25, 10], [50, 10], [32, 10])
    # In the overlap, lime is over red, premultiplied; then half of the result is over white.
    alpha = 0.25 + 0.75 * 0.5
    overlap = [0.75 * 0.5 / 2 + 1 - alpha / 2, 0.25 / 2 + 1 - alpha / 2, 1 - alpha / 2]
    np.testing.assert_allclose(
        result, [[1, 0.75, 0.75], overlap, [0.875, 1, 0.875], half(BLUE)], atol=1e-12
    )


def test_what_cannot_be_exact_is_named():
    stops = '<stop stop-color="red" stop-opacity="0"/><stop offset="1" stop-color="red"/>'
    body = (
        f'<linearGradient id="g">{stops}</linearGradient>\n<g opacity=".5"><rect width="40" '
        'height="40" fill="url(#g)"/><rect x="20" width="40" height="40" fill="url(#g)"/></g>'
    )
    with pytest.warns(UserWarning, match=r"drawn approximately: opacity of <g> \(line 2: "):
        read_body(body)


def test_groups_within_groups():
    inner = '<g opacity=".5"><rect width="40" height="40"/><rect width="20" height="20"/></g>'
    result = body_colors(f'<g opacity=".5">{inner}<rect x="30" width="30" height="30"/></g>',
                    [10, 10], [25, 35], [35, 10], [55, 10])  # fmt: skip
    np.testing.assert_allclose(result[:, 0], [0.75, 0.75, 0.5, 0.5])
    assert read_body(f'<g opacity="0">{inner}</g>').triangles.size == 0
    assert read_body(inner, opacity=False).colors.shape[-1] == 3


def test_clip_paths_by_hand():
    clip = '<clipPath id="c"><circle cx="40" cy="40" r="20"/><path d="M0 0h9v9H0z"/></clipPath>'
    rect = '<rect width="100" height="80" fill="red"'
    for body in (f'{rect} clip-path="url(#c)"/>', f'<g clip-path="url(#c)">{rect}/></g>'):
        result = body_colors(clip + body, [5, 5], [40, 40], [15, 15], [57, 55], [58, 45])
        assert result.tolist() == [RED, RED, WHITE, WHITE, RED]


@pytest.mark.parametrize(
    ("clip", "inside"),
    [
        ('<clipPath id="c" clipPathUnits="objectBoundingBox"><rect width=".5" height=".5"/>'
         "</clipPath>", [True, False, False]),
        ('<clipPath id="c" transform="translate(40)"><rect x="-40" width="60" height="80"/>'
         "</clipPath>", [True, True, False]),
        ('<clipPath id="c"><path clip-rule="evenodd" d="M0 0H100V80H0Z M30 0h20v80h-20z"/>'
         "</clipPath>", [True, False, True]),
        ('<clipPath id="d"><rect width="30" height="80"/></clipPath><clipPath id="c">'
         '<rect width="60" height="80" clip-path="url(#d)"/><rect x="70" width="9" height="80"/>'
         "</clipPath>", [True, False, True]),
        # A clip path on a clip path ignores the transform of the latter: it has the element's.
        ('<clipPath id="d"><rect width="30" height="80"/></clipPath><clipPath id="c" '
         'clip-path="url(#d)" transform="translate(30)"><rect x="-30" width="60" height="80"/>'
         "</clipPath>", [True, False, False]),
        # For a clip path on a clip path, the bounding box is the element's. For a clip path on a
        # child of a clip path (next case), it is the child's.
        ('<clipPath id="d" clipPathUnits="objectBoundingBox"><rect width=".4" height="1"/>'
         '</clipPath><clipPath id="c" clip-path="url(#d)"><rect width="80" height="80"/>'
         "</clipPath>", [True, False, False]),
        ('<clipPath id="d" clipPathUnits="objectBoundingBox"><rect width=".5" height="1"/>'
         '</clipPath><clipPath id="c"><rect x="30" width="40" height="80" clip-path="url(#d)"/>'
         "</clipPath>", [False, True, False]),
        ('<clipPath id="c" style="transform: translateX(10px)"><rect width="60" height="80" '
         'transform="scale(.5 1)" style="transform-box: fill-box; transform-origin: right"/>'
         "</clipPath>", [False, True, False]),
        ('<clipPath id="c"/>', [False, False, False]),
        ('<clipPath id="c"><g><rect width="60" height="80"/></g></clipPath>', [False] * 3),
        ('<rect id="r" width="30" height="80" fill="none"/><clipPath id="c">'
         '<use href="#r" x="30"/></clipPath>', [False, True, False]),
    ],
)  # fmt: skip
def test_clip_paths_of_every_kind(clip, inside):
    rect = '<g clip-path="url(#c)"><rect width="80" height="80" fill="red"/></g>'
    result = body_colors(clip + rect, [20, 20], [40, 20], [75, 20])
    assert result.tolist() == [RED if shown else WHITE for shown in inside]


def test_clipped_translucent_shapes_with_gradients():
    body = (
        '<linearGradient id="g"><stop stop-color="red"/><stop offset="1" stop-color="red"/>'
        '</linearGradient><clipPath id="c"><circle cx="40" cy="40" r="20"/></clipPath>'
        '<g opacity=".5" clip-path="url(#c)"><rect width="90" height="80" fill="url(#g)"/>'
        '<rect x="40" width="50" height="80"/></g>'
    )
    result = body_colors(body, [30, 40], [50, 40], [5, 40])
    np.testing.assert_allclose(result, [half(RED), [0.5] * 3, WHITE], atol=1e-6)


def test_use_draws_copies_with_inherited_style():
    body = (
        '<defs><g id="g"><rect id="r" width="10" height="10"/></g></defs>'
        '<use href="#g" x="20" fill="red"/><use href="#r" transform="translate(40)" fill="lime"/>'
    )
    result = body_colors(body, [25, 5], [45, 5], [5, 5])
    assert result.tolist() == [RED, LIME, WHITE]


def test_symbols_and_nested_viewports_clip_what_they_scale():
    symbol = '<symbol id="s" viewBox="0 0 10 10"><rect x="5" width="10" height="10"/></symbol>'
    result = body_colors(symbol + '<use href="#s" width="40" height="40"/>',
                    [10, 10], [30, 10], [45, 10])  # fmt: skip
    assert result[:, 0].tolist() == [1, 0, 1]
    nested = '<svg x="10" y="10" width="50%" height="40" {}><rect width="100%" height="50"/></svg>'
    for overflow, below in (("", 1), ('overflow="visible"', 0)):
        result = body_colors(nested.format(overflow), [5, 20], [55, 20], [65, 20], [20, 55])
        assert result[:, 0].tolist() == [1, 0, 1, below]


def test_switch_and_system_language():
    rects = '<rect width="9" height="9" fill="red" {}/><rect width="9" height="9" fill="lime" {}/>'
    for first, second, wanted in (
        ('systemLanguage="fr"', "", LIME),
        ('systemLanguage="fr, en-GB"', "", RED),
        ('requiredExtensions="x"', "", LIME),
        ('requiredExtensions="x"', 'systemLanguage="fr"', WHITE),
    ):
        result = body_colors(f"<switch>{rects.format(first, second)}</switch>", [5, 5])
        assert result.tolist() == [wanted]
    # `systemLanguage` hides elements outside of a switch too.
    assert read_body('<rect width="9" height="9" systemLanguage="fr"/>').triangles.size == 0


def test_transform_origin():
    for origin, transform in (
        ('transform-origin="50 40"', 'transform="rotate(180)"'),
        ('transform-origin="center"', 'transform="rotate(180)"'),
        ('style="transform-origin: 50% 50%; transform: rotate(.5turn)"', ""),
        ('style="transform-origin: right bottom; transform: translateX(-2px)" '
         'transform-box="view-box"', ""),
    ):  # fmt: skip
        result = body_colors(
            f'<rect width="10" height="10" {origin} {transform}/>', [95, 75], [5, 5]
        )
        assert result[:, 0].tolist() == ([1, 0] if "translateX" in origin else [0, 1])
    # If one value is given, the other axis has its origin at the center.
    one = 'transform-origin="0" transform="scale(1 -1)"'
    result = body_colors(f'<rect width="10" height="10" {one}/>', [5, 75], [5, 5])
    assert result[:, 0].tolist() == [0, 1]
    css = 'style="transform-box: fill-box; transform-origin: 100% 0; transform: scale(2)"'
    result = body_colors(f'<rect x="40" y="10" width="10" height="10" {css}/>', [35, 25], [55, 15])
    assert result[:, 0].tolist() == [0, 1]


def test_geometry_in_style_sheets():
    body = "<style>rect { width: 20px; height: 50%; x: 10px } circle { r: 5px }</style>"
    result = body_colors(body + '<rect width="90"/><circle cx="50" cy="9"/>',
                    [15, 35], [5, 5], [35, 5], [53, 9])  # fmt: skip
    assert result[:, 0].tolist() == [0, 1, 1, 0]


CORNER = '<rect width="10" height="10" fill="red" {}/>'


@pytest.mark.parametrize(
    "style",
    [
        "transform: translate(40px, 30px)", "transform: translate(40%, 37.5%)",
        "transform:translateX(40px)translateY(30px)", "transform: matrix(1, 0, 0, 1, 40, 30)",
        "transform: scale(200%) translate(20px, 15px) scale(.5, .5)",
        "translate: 40px 30px", "translate: 20px 10px; transform: translate(20px, 20px)",
        # `scale` is about the origin of `transform`, and does not scale `translate`.
        "translate: 40px 30px; scale: 50%; transform: scale(2)",
        "translate: 40px 30px; rotate: 180deg; transform: rotate(.5turn) rotate(0)",
        "transform-box: fill-box; transform: translate(400%, 300%)",
        "transform-origin: 50px 40px; rotate: z 3.14159265rad",
        # An invalid declaration has no effect, so an earlier valid one counts.
        "transform: translate(40px, 30px); transform: translate(90, 90)",
    ],
)  # fmt: skip
def test_css_transforms(style):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore" if "90" in style else "error")
        turned = "origin" in style
        result = body_colors(
            CORNER.format(f'style="{style}"'), [95, 75] if turned else [45, 35], [5, 5]
        )
    assert result.tolist() == [RED, WHITE]


@pytest.mark.parametrize(
    ("declaration", "reason"),
    [
        ("transform: translate(40, 30)", "length '40' has no unit"),
        ("transform: translate(40px 30px)", "expected a length"),
        ("transform: rotate(180)", "'180' has no"), ("transform: skewX(10)", "'10' has no unit"),
        ("transform: scale(2 2)", "not a finite"), ("transform: scale(1_0)", "not a finite"),
        ("transform: translate(40px), scale(2)", "expected a function"),
        ("transform: scale(2, 2, 2)", "takes 1 or 2 values, got 3"),
        ("transform: matrix(1, 0, 0, 1, 9px, 0)", "9px"), ("scale: 2px", "2px"),
        ("translate: 40 30", "length '40' has no unit"), ("rotate: 180", "angle '180' has no unit"),
        ("rotate: x 180deg", "takes 1 values, got 2"),
    ],
)  # fmt: skip
def test_invalid_css_transforms_are_named(declaration, reason):
    name = declaration.partition(":")[0]
    with pytest.warns(UserWarning, match=f"invalid: {name} of <rect> .line 1: .*{reason}"):
        result = body_colors(CORNER.format(f'style="{declaration}"'), [5, 5], [45, 35])
    assert result.tolist() == [RED, WHITE]
    # The attribute counts if no declaration of the property is valid.
    attribute = f'style="{declaration}" transform="translate(40 30)"'
    with pytest.warns(UserWarning, match=f"invalid: {name} of <rect>"):
        result = body_colors(CORNER.format(attribute), [5, 5], [45, 35])
    assert result.tolist() == [WHITE, RED]


def test_invalid_geometry_in_css_leaves_the_attribute():
    with pytest.warns(UserWarning, match=r"width of <rect> .line 1: .*'40q#'"):
        result = body_colors('<rect width="20" height="9" style="width: 40q#"/>', [10, 5], [30, 5])
    assert result[:, 0].tolist() == [0, 1]


def test_lengths_in_css_have_units():
    with pytest.warns(UserWarning, match=r"width of <rect> .line 1: the length '40' has no unit"):
        result = body_colors(
            '<rect width="20" height="9" style="width: 40; x: 0"/>', [10, 5], [30, 5]
        )
    assert result[:, 0].tolist() == [0, 1]


def test_origins_in_css_have_units():
    origin = 'transform="rotate(180)" transform-origin="50 40"'
    for attributes, corner in ((origin, [95, 75]), (f'{origin} style="x: 0"', [95, 75])):
        assert body_colors(CORNER.format(attributes), corner).tolist() == [RED]
    with pytest.warns(UserWarning, match="transform-origin of <rect> .line 1: has no unit"):
        read_body(CORNER.format('style="transform-origin: 50 40"'))


@pytest.mark.parametrize(
    ("background", "wanted"),
    [
        ("background: lime", LIME), ("background: no-repeat rgb(0 255 0) fixed", LIME),
        ("background: red; background-color: lime", LIME), ("background: none", WHITE),
        ("background-color: red; background: lime", LIME),
        ("background-color: red; background: none", WHITE),
        ("color: lime; background: currentColor", LIME),
    ],
)  # fmt: skip
def test_the_background_of_the_root(background, wanted):
    text = f'<svg style="{background}" width="9" height="9"><rect width="3" height="3"/></svg>'
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert parse_svg(text).background.tolist() == wanted


def test_css_that_browsers_draw_is_named():
    for declaration in ("animation: a 2s", "offset-path: path(&apos;M0 0h9&apos;)", "zoom: 2",
                        "mask-image: url(#m)"):  # fmt: skip
        name = declaration.partition(":")[0]
        with pytest.warns(UserWarning, match=f"without effect: {name} of <rect> .line 1: "):
            read_body(CORNER.format(f'style="{declaration}"'))
    text = '<svg style="background: lime url(a.png)" width="9" height="9"/>'
    with pytest.warns(UserWarning, match=r"background of <svg> .line 1: images are not drawn"):
        assert parse_svg(text).background.tolist() == LIME


def test_strokes_of_curves_dashes_and_order():
    circle = '<circle cx="40" cy="40" r="20" fill="red" stroke="blue" stroke-width="8"'
    result = body_colors(f"{circle}/>", [40, 40], [57, 40], [63, 40], [65, 40])
    assert result.tolist() == [RED, BLUE, BLUE, WHITE]
    result = body_colors(f'{circle} paint-order="stroke"/>', [57, 40], [63, 40])
    assert result.tolist() == [RED, BLUE]
    dashed = '<path d="M10 10H90" stroke="red" stroke-width="4" stroke-dasharray="20 10"/>'
    assert body_colors(dashed, [20, 10], [35, 10], [50, 10]).tolist() == [RED, WHITE, RED]
    thin = (
        '<g transform="scale(10 2)"><path d="M1 1V30" stroke="red" stroke-width="4" '
        'vector-effect="non-scaling-stroke"/></g>'
    )
    result = body_colors(thin, [8.5, 20], [11.5, 20], [7, 20], [13, 20])
    assert result.tolist() == [RED, RED, WHITE, WHITE]


def test_a_lone_moveto_draws_no_dot():
    pen = 'stroke="red" stroke-width="8" stroke-linecap="round"'
    for data, wanted in (("M20 20", WHITE), ("M20 20L20 20", RED), ("M20 20Z", RED)):
        assert body_colors(f'<path d="{data}" {pen}/>', [20, 20]).tolist() == [wanted]


def test_translucent_strokes_in_order():
    body = "".join(
        f'<path d="M10 {y}H50V{y - 5}" fill="none" stroke="{color}" stroke-width="8" '
        f'stroke-opacity="{opacity}"/>'
        for y, color, opacity in (
            (20, "red", 0.5),
            (20, "blue", 1),
            (20, "red", 0.5),
            (50, "lime", 0.5),
        )
    )
    result = body_colors(body, [20, 20], [50, 20], [20, 50], [50, 50])
    np.testing.assert_allclose(result, [[0.5, 0, 0.5]] * 2 + [half(LIME)] * 2)


def test_path_length_scales_dashes():
    path = '<path d="M10 20H50M50 20H90" stroke="red" stroke-width="8" stroke-dasharray="1 1" {}/>'
    at = [[15, 20], [25, 20], [35, 20]]
    assert body_colors(path.format('pathLength="8"'), *at)[:, 1].tolist() == [0, 1, 0]
    moved = 'pathLength="8" stroke-dashoffset="1"'
    assert body_colors(path.format(moved), *at)[:, 1].tolist() == [1, 0, 1]
    # A path length of zero scales every dash to infinity. The first dash then never ends.
    assert body_colors(path.format('pathLength="0"'), *at)[:, 1].tolist() == [0, 0, 0]
    for text in ("-8", "x"):
        with pytest.warns(UserWarning, match="pathLength of <path>"):
            scene = read_body(path.format(f'pathLength="{text}"'))
        assert scene.triangles.size == read_body(path.format("")).triangles.size


@pytest.mark.parametrize("join", ["miter", "round"])
def test_relative_paths_close_without_a_spike(join):
    """In float64, the steps of the path add up to about 1e-15 instead of 0."""
    steps = "l.1 .2l.2 .1l-.1 .2l-.2-.5"
    path = '<g transform="scale(80)"><path d="M.3 .3{}{}" stroke="red" stroke-width=".01" {}/></g>'
    pen = f'fill="none" stroke-linejoin="{join}" stroke-miterlimit="99"'
    closed = corners_of(read_body(path.format(steps, "z", pen)))
    exact = corners_of(read_body(path.format("l.1 .2l.2 .1l-.1 .2", "z", pen)))
    assert closed.shape == exact.shape
    np.testing.assert_allclose(closed, exact, atol=1e-4)


def test_joins_that_are_clipped():
    spike = '<path d="M10 38L60 40L10 42" fill="none" stroke="red" stroke-width="4" {}/>'
    reach = {}
    for join in ("bevel", "miter", "miter-clip"):
        scene = read_body(spike.format(f'stroke-linejoin="{join}" stroke-miterlimit="3"'))
        reach[join] = corners_of(scene)[..., 0].max()
    # A miter over the limit becomes a bevel. With `miter-clip`, it is cut off at three half widths
    # from the corner.
    assert reach["miter"] == reach["bevel"] < 61
    assert reach["miter-clip"] == pytest.approx(66)


@pytest.mark.parametrize(
    "body",
    [
        '<use id="u" href="#u"/>',
        '<g id="g"><use href="#g"/></g>',
        '<defs><g id="a"><use href="#b"/></g><g id="b"><use href="#a"/></g></defs><use href="#a"/>',
        '<clipPath id="c" clip-path="url(#c)"/><rect width="9" height="9" clip-path="url(#c)"/>',
        '<linearGradient id="g" href="#g"/><rect width="9" height="9" fill="url(#g)"/>',
    ],
)
def test_references_to_themselves_are_named(body):
    with pytest.warns(UserWarning, match="refers to (itself|an ancestor)"):
        read_body(body)


@pytest.mark.parametrize("limit", [2000, pytest.param(MAX_COPIES, marks=pytest.mark.slow)])
def test_copies_of_copies_are_refused_beyond_a_limit(limit, monkeypatch):
    monkeypatch.setitem(budget._LIMITS, "copies", budget._Limit(limit, "copies of elements"))
    levels = "".join(
        f'<g id="g{k}">' + f'<use href="#g{k - 1}"/>' * 10 + "</g>" for k in range(1, 10)
    )
    body = f'<defs><g id="g0"><rect width="1" height="1"/></g>{levels}</defs><use href="#g9"/>'
    with pytest.raises(ValueError, match=f"copies of elements; at most {limit:,}"):
        read_body(body)
