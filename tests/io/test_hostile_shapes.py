"""Shapes made to take hours are read, or refused in one line, within seconds."""

import warnings

import numpy as np
import pytest

from softras2d.io.svg.reading.reader import parse_svg

from ..cases.hostile import (
    ends_within,
    low_poly,
    many_paths,
    outcome,
    points,
    polygon,
    random,
    spiral,
)


def wave(count):
    across = np.linspace(0, 10, count)
    upper = np.stack([across, 5 + 4 * np.sin(40 * across)], axis=1)
    lower = np.stack([across[::-1], np.full(count, 5.1)], axis=1)
    return np.concatenate([upper, lower])


BLACK = 'fill="black"'


TRANSLUCENT = 'fill-opacity=".5"'


STROKE = 'fill="none" stroke="red" stroke-linejoin="round" stroke-linecap="round"'


# A drawing, and for the dialect `svg` its number of triangles, or what the error must contain.
SHAPES = {
    "equal points": (polygon(np.ones((20_000, 2))), 0),
    "one segment, to and fro": (polygon(np.tile([[1, 1], [9, 9]], (10_000, 1))), 0),
    "a square, again and again": (
        polygon(np.tile([[1, 1], [9, 1], [9, 9], [1, 9]], (5_000, 1))), 2,
    ),
    "a wave and a line": (polygon(wave(20_000)), None),
    "a spiral": (polygon(spiral(20_000)), None),
    "a spiral of glass": (polygon(spiral(10_000), TRANSLUCENT), None),
    "tangles": ("".join(polygon(random(440, seed)) for seed in range(30)), "cross themselves"),
    "small tangles": ("".join(polygon(random(60, i)) for i in range(300)), "cross themselves"),
    "a long tangle": (polygon(random(100_000)), "cross"),
    "huge joins": (
        f'<polyline points="{points(random(20_000))}" {STROKE} transform="scale(1e15)"/>',
        "2,097,152",
    ),
    "a stroke of glass": (
        f'<polyline points="{points(random(20_000))}" {STROKE} stroke-opacity=".5"/>',
        "pairs of edges",
    ),
    "zigzag": (polygon([[i % 2 * 9, i / 2000] for i in range(15_000)]), None),
}  # fmt: skip


@pytest.mark.parametrize("dialect", ["svg", "course"])
@pytest.mark.parametrize("name", SHAPES)
def test_costly_shapes_are_read_or_refused_in_time(name, dialect):
    body, expected = SHAPES[name]
    with ends_within(20):
        result = outcome(f'<svg width="10" height="10">{body}</svg>', dialect, frame=False)
    if dialect == "course":
        return
    if isinstance(expected, str):
        assert isinstance(result, str) and expected in result
        assert "at most" in result
    else:
        assert not isinstance(result, str), result
        assert expected is None or result.triangles.shape[0] == expected


@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "triangles"),
    [
        pytest.param(low_poly(5078), 5078, id="5,078 paths of one triangle"),
        pytest.param(many_paths(1000), 98_000, id="1e5 points"),
    ],
)
def test_large_drawings_are_read_in_time_without_a_warning(body, triangles):
    """The limit is loose, since run-time type checks are slow; `experiments/svg_files` measures."""
    text = f'<svg xmlns="http://www.w3.org/2000/svg" width="10" height="10">{body}</svg>'
    with ends_within(30), warnings.catch_warnings():
        warnings.simplefilter("error")
        assert parse_svg(text).triangles.shape[0] == triangles


@pytest.mark.slow
def test_an_opaque_stroke_of_many_dashes_in_a_group_is_cut_out_in_time():
    """The area that the stroke hides is removed from both rectangles, and no more."""
    drawing = (
        '<svg><g opacity="0.5"><rect width="9000" height="40"/><rect width="9000" height="40"/>'
        '<path d="M0 20H120000" stroke="red" stroke-dasharray="3 1" stroke-width="2"/></g></svg>'
    )
    with ends_within(20):
        scene = outcome(drawing)
    assert area(scene) == pytest.approx(9000 * 40 + 111_000 / 4 * 3 * 2, rel=1e-3)


def area(scene):
    positions = np.asarray(scene.positions, np.float64)
    a, b, c = np.moveaxis(positions[np.asarray(scene.triangles)], 1, 0)
    return np.abs((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]).sum() / 2


@pytest.mark.parametrize("style", [BLACK, TRANSLUCENT])
def test_large_polygons_have_their_area(style):
    """The triangles of a spiral have the area that the shoelace formula gives."""
    outline = spiral(1500) * 8 + 40
    x, y = outline.T
    expected = abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2
    scene = parse_svg(f'<svg width="80" height="80">{polygon(outline, style)}</svg>')
    assert area(scene) == pytest.approx(expected, rel=1e-3)


def test_fill_rules_of_a_large_polygon():
    """A curve winds twice around a disc, which is a hole under the even-odd rule alone."""
    angle = np.linspace(0, 4 * np.pi, 400, endpoint=False)
    radius = np.where(angle < 6.2831, 4, 2)[:, None]
    ring = 5 + np.stack([np.cos(angle), np.sin(angle)], axis=1) * radius
    filled, hole = (
        area(parse_svg(f'<svg width="10" height="10">{polygon(ring, rule)}</svg>'))
        for rule in ('fill-rule="nonzero"', 'fill-rule="evenodd"')
    )
    assert filled == pytest.approx(np.pi * 16, rel=0.01)
    assert hole == pytest.approx(np.pi * 12, rel=0.01)
