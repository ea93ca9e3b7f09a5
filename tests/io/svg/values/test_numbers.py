"""Numbers, lengths, transforms and views are parsed right: by hand, and by hypothesis."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softras2d.geometry import affine_maps
from softras2d.io.svg.css.cascade import Declarations
from softras2d.io.svg.elements import view_box
from softras2d.io.svg.elements.view_box import Box
from softras2d.io.svg.values import transform_attribute
from softras2d.io.svg.values.numbers import (
    blank_separated,
    finite,
    leading_float,
    length,
    number_list,
    number_pairs,
)

FINITE = st.floats(-1e30, 1e30)
SMALL = st.floats(-100, 100).filter(lambda x: x == 0 or abs(x) > 1e-6)


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("", []),
        ("  ", []),
        ("1 2,3 , 4\n5\t6", [1, 2, 3, 4, 5, 6]),
        ("10-20", [10, -20]),
        (".5.5", [0.5, 0.5]),
        ("1e2-3E-1+4", [100, -0.3, 4]),
        ("1.5.5-.5", [1.5, 0.5, -0.5]),
        ("1.,2.", [1, 2]),
    ],
)
def test_number_lists_by_hand(text, numbers):
    assert number_list(text) == numbers


@pytest.mark.parametrize(
    "text", ["a", "1 x", "1,,2", ",1", "nan", "1 inf", "1e999", "1_0", "--1", "1 2 3e", "٣", "1 2,"]
)
def test_invalid_number_lists_are_refused(text):
    if text == "1 2,":
        assert number_list("1 2") == [1, 2]
    with pytest.raises(ValueError, match=r"expected a number|finite"):
        number_list(text)


@pytest.mark.parametrize(
    ("text", "number"), [("12", 12), ("-.5", -0.5), ("+1e3", 1000), ("1.", 1), ("007", 7)]
)
def test_single_numbers_by_hand(text, number):
    assert finite(text) == number


@pytest.mark.parametrize(
    "text", ["1_000", "1e1_0", "٣", "nan", "-Infinity", "1e999", "0x1", "", " 1", "1\n", "1px"]
)
def test_spellings_that_only_python_reads_are_no_numbers(text):
    with pytest.raises(ValueError, match="finite number"):
        finite(text)


@given(st.lists(FINITE), st.sampled_from([" ", ",", " , ", "\n"]))
def test_any_number_list_is_read_exactly(numbers, separator):
    text = separator.join(map(repr, numbers))
    assert number_list(text) == numbers


@given(st.lists(FINITE))
def test_signs_separate_numbers(numbers):
    text = "".join(f"{number:+}" for number in numbers)
    assert number_list(text) == numbers


@given(st.text("0123456789.,-+eE \n%xnaif", max_size=12))
def test_any_text_gives_numbers_or_one_error(text):
    for read in (
        number_list,
        number_pairs,
        blank_separated,
        leading_float,
    ):
        try:
            assert np.isfinite(read(text)).all()
        except ValueError as error:
            assert str(error).count("\n") == 0


@pytest.mark.parametrize(
    ("text", "px"),
    [
        ("12", 12), ("12px", 12), ("1in", 96), ("2.54cm", 96), ("25.4mm", 96), ("72pt", 96),
        ("6pc", 96), ("101.6Q", 96), ("50%", 100), ("-3", -3), ("1e1px", 10), (" 4 ", 4),
    ],
)  # fmt: skip
def test_lengths_by_hand(text, px):
    assert length(text, 200.0) == pytest.approx(px, rel=1e-15)


@pytest.mark.parametrize(
    "text", ["2em", "1ex", "3rem", "1vw", "px", "", "1 2", "nan", "1e400", "1e308in"]
)
def test_invalid_lengths_are_refused(text):
    with pytest.raises(ValueError, match=r"length|finite"):
        length(text, 200.0)


def test_course_numbers_are_float32():
    assert leading_float("272.863px") == float(np.float32(272.863))
    assert leading_float(None) == 0.0
    assert number_pairs("0.1,0.2") == [float(np.float32(0.1)), float(np.float32(0.2))]


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("1,2 3,4", [1, 2, 3, 4]),
        ("1, 2\n3,4", [1, 2, 3, 4]),
        ("1;2 3/4", [1, 2, 3, 4]),
        ("1 2 3 4", [1, 2, 3, 4]),
        ("1,2 3,,4 5,6", [1, 2]),  # reading stops at two separators
        ("1,2 x 3,4", [1, 2]),
        ("1,2 3", [1, 2]),
    ],
)
def test_course_points_by_hand(text, numbers):
    assert number_pairs(text) == numbers


@pytest.mark.parametrize(
    ("text", "point"),
    [
        ("translate(10,20)", (11, 21)),
        ("translate(10)", (11, 1)),
        ("scale(2)", (2, 2)),
        ("scale(2 3)", (2, 3)),
        ("rotate(90)", (-1, 1)),
        ("rotate(90, 1, 2)", (2, 2)),
        ("skewX(45)", (2, 1)),
        ("skewY(45)", (1, 2)),
        ("matrix(1 2 3 4 5 6)", (9, 12)),
        ("translate(10,0)scale(2),rotate(90)", (8, 2)),
        ("  translate( 1 , 2 )\n scale(2)  ", (3, 4)),
        ("none", (1, 1)),
        ("", (1, 1)),
    ],
)
def test_transform_lists_by_hand(text, point):
    moved = affine_maps.apply(transform_attribute.transform_list(text), [1.0, 1.0])
    np.testing.assert_allclose(moved, point, atol=1e-12)


@pytest.mark.parametrize(
    "text",
    ["spin(3)", "translate", "translate(1", "translate()", "scale(1 2 3)", "rotate(1 2)",
     "matrix(1 2 3 4 5)", "translate(a)", "scale(nan)", "skewX(1 2)", "translate(1) garbage"],
)  # fmt: skip
def test_invalid_transform_lists_are_refused(text):
    with pytest.raises(ValueError, match=r"function|number"):
        transform_attribute.transform_list(text)


@given(SMALL, SMALL, SMALL, SMALL)
def test_transform_functions_multiply_left_to_right(x, y, angle, factor):
    text = f"translate({x!r},{y!r}) rotate({angle!r}) scale({factor!r})"
    wanted = affine_maps.translate(x, y) @ affine_maps.rotate(angle) @ affine_maps.scale(factor)
    np.testing.assert_allclose(transform_attribute.transform_list(text), wanted, atol=1e-9)


@pytest.mark.parametrize(
    ("text", "point", "unknown"),
    [
        ("translate(10 20)", (11, 21), []),
        ("translate(10,20)", (11, 1), []),  # a comma stops the reading
        ("translate(10px 20)", (11, 1), []),
        ("scale(2)", (2, 1), []),  # scales x alone
        ("scale()", (1, 1), []),
        ("rotate(90)", (-1, 1), []),
        ("rotate(90 1 2)", (2, 2), []),
        ("skewX(45)", (2, 1), []),
        ("matrix(1,2,3,4,5,6)", (9, 12), []),  # here a comma counts as a blank
        ("matrix(1 2 3 4 5 6)", (9, 12), []),
        ("translate(10 0) scale(2 2)", (12, 2), []),
        ("translate(10 0),scale(2 2)", (12, 2), []),  # any one character separates functions
        ("translate(10 0)  scale(2 2)", (11, 1), [" scale"]),  # the second blank is in the name
        ("translate(10 0)scale(2 2)", (11, 1), ["cale"]),  # the first letter is the separator
        (" translate(10 0)", (1, 1), [" translate"]),
    ],
)
def test_course_transforms_by_hand(text, point, unknown):
    names = []
    moved = affine_maps.apply(transform_attribute.course_transform(text, names.append), [1.0, 1.0])
    np.testing.assert_allclose(moved, point, atol=1e-6)
    assert names == unknown


ALIGNMENTS = [(x, y) for x in ("Min", "Mid", "Max") for y in ("Min", "Mid", "Max")]


@pytest.mark.parametrize(("x", "y"), ALIGNMENTS)
@pytest.mark.parametrize("how", ["meet", "slice"])
def test_preserve_aspect_ratio_by_hand(x, y, how):
    """A viewBox 10 x 20 at (5, 6) in a viewport 60 wide and 40 high has scales 6 and 2."""
    map3 = view_box.fit(Box(5.0, 6.0, 10.0, 20.0), 40.0, 60.0, f"x{x}Y{y} {how}")
    share = {"Min": 0.0, "Mid": 0.5, "Max": 1.0}
    factor = 2.0 if how == "meet" else 6.0
    left = share[x] * (60 - 10 * factor)
    top = share[y] * (40 - 20 * factor)
    wanted = [[left, top], [left + 10 * factor, top + 20 * factor]]
    np.testing.assert_allclose(affine_maps.apply(map3, [[5.0, 6.0], [15.0, 26.0]]), wanted)


def test_preserve_aspect_ratio_may_be_none_or_left_out():
    box = Box(5.0, 6.0, 10.0, 20.0)
    corners = [[5.0, 6.0], [15.0, 26.0]]
    stretched = affine_maps.apply(view_box.fit(box, 40.0, 60.0, "none"), corners)
    np.testing.assert_allclose(stretched, [[0, 0], [60, 40]])
    view_box.fit(box, 40.0, 60.0, "none slice")
    default = view_box.fit(box, 40.0, 60.0)
    for text in ("xMidYMid meet", "xMidYMid", "defer xMidYMid meet"):
        np.testing.assert_array_equal(view_box.fit(box, 40.0, 60.0, text), default)


@pytest.mark.parametrize("text", ["xMidYmid", "middle", "xMinYMin crop", "none none", "x y"])
def test_invalid_preserve_aspect_ratio_is_refused(text):
    with pytest.raises(ValueError, match="preserveAspectRatio"):
        view_box.fit(Box(0.0, 0.0, 1.0, 1.0), 1.0, 1.0, text)


@given(st.floats(1, 2000), st.floats(1, 2000), st.integers(1, 2000), st.integers(1, 2000))
def test_course_view_has_its_closed_form(height, width, tall, wide):
    map3 = view_box.course_view((height, width), tall, wide)
    factor = min(wide, tall) / (1.2 * max(width, height))
    points = np.array([[0.0, 0.0], [width, height], [3.0, -7.0]])
    wanted = np.array([wide, tall]) / 2 + factor * (points - np.array([width, height]) / 2)
    np.testing.assert_allclose(affine_maps.apply(map3, points), wanted, rtol=1e-9, atol=1e-9)


def size_of(css=None, **attributes):
    """The size of a root element, from CSS values, highest rank first, and from attributes."""
    css = css or {}
    outranked = {name: values[:0:-1] for name, values in css.items()}
    highest = {name: values[0] for name, values in css.items()}
    declared = Declarations(highest, attributes, outranked)
    return view_box.document_size(declared, 16.0, lambda *_: None)


def test_document_sizes_by_hand():
    assert size_of(width="20", height="10") == (10, 20)
    assert size_of(width="1in", height="72pt") == (96, 96)
    assert size_of(viewBox="5 5 30 40") == (40, 30)
    assert size_of(viewBox="0 0 30 40", width="60") == (80, 60)
    assert size_of(viewBox="0 0 30 40", height="20") == (20, 15)
    assert size_of(viewBox="0 0 30 40", width="100%", height="100%") == (40, 30)
    assert size_of(viewBox="0 0 30 40", width="50%", height="50%") == (20, 15)
    assert size_of(width="20") is None
    assert size_of(width="100%", height="10") is None
    assert view_box.course_size({"width": "272.863px"}) == (0, float(np.float32(272.863)))
    assert view_box.course_size({"viewBox": "0 0 5 5"}) is None


def test_css_outranks_the_size_in_attributes():
    css = {"width": ["3em"], "height": ["12"]}
    # The height in CSS has no unit and is invalid, so the attribute counts.
    assert size_of(css, width="20", height="10") == (10, 48)
    assert size_of({"width": ["-5px", "7px"], "height": ["0px", "2q#"]}, height="10") == (10, 7)
    box = "0 0 30 40"
    assert size_of({"width": ["auto"]}, viewBox=box, width="60", height="20") == (20, 15)
    assert size_of({"width": ["100%"]}, viewBox=box, width="60") == (40, 30)
    assert size_of({"width": ["50%"]}, viewBox=box, width="60", height="9") == (9, 15)
    # Without a viewBox, percentages are relative to nothing, and the attributes count.
    assert size_of({"width": ["50%"], "height": ["auto"]}, width="60", height="9") == (9, 60)


def test_sizes_round_up():
    assert view_box.round_up((10.0, 10.2)) == (10, 11)
    assert view_box.round_up((96 / 25.4 * 25.4, 0.2)) == (96, 1)
    assert math.ceil(96 / 25.4 * 210) == view_box.round_up((96 / 25.4 * 210, 1.0))[0]
