"""Lines of pixels equal the course's rule, applied step by step in float32."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softras2d.io.shapes.pixel_lines import advance, pixel_lines

from ...cases.work import count_calls

COORDINATE = st.floats(-300, 300, width=32)


def slow_line(x0, y0, x1, y1):
    """The pixels (x, y) that the course's rule colours, in order."""
    x0, y0, x1, y1 = (np.float32(v) for v in (x0, y0, x1, y1))
    if x0 > x1:
        x0, y0, x1, y1 = x1, y1, x0, y0
    dx, dy = x1 - x0, y1 - y0
    one = np.float32(1)
    if dx == 0:
        step = (np.float32(0), np.sign(dy))
    elif abs(dy / dx) <= 1:
        step = (one, dy / dx)
    else:
        step = (one / abs(dy / dx), np.sign(dy / dx))
    x, y, pixels = x0, y0, []
    while np.floor(x) <= np.floor(x1) and abs(y - y0) <= abs(y1 - y0):
        pixels.append((int(np.floor(x)), int(np.floor(y))))
        if step == (0, 0):
            break
        x, y = x + step[0], y + step[1]
    return pixels


def pixels_of(rectangles):
    return [
        (x, y)
        for x0, y0, x1, y1 in rectangles.tolist()
        for y in range(y0, y1)
        for x in range(x0, x1)
    ]


def drawn(*segment, height=64, width=64):
    rectangles, line = pixel_lines(np.array([segment], np.float32), height, width)
    assert (line == 0).all()
    return rectangles


@pytest.mark.parametrize(
    ("segment", "rectangles"),
    [
        ((1.5, 2.5, 4.5, 2.5), [[1, 2, 5, 3]]),
        ((4.5, 2.5, 1.5, 2.5), [[1, 2, 5, 3]]),
        ((1.5, 2.5, 1.5, 4.5), [[1, 2, 2, 5]]),
        ((1.5, 4.5, 1.5, 2.5), [[1, 2, 2, 5]]),
        ((1.3, 1.3, 1.3, 1.3), [[1, 1, 2, 2]]),
        # A vertical line steps from its first point: y is 0.3, 1.3; in reverse, 2.1, 1.1.
        ((0.5, 0.3, 0.5, 2.1), [[0, 0, 1, 2]]),
        ((0.5, 2.1, 0.5, 0.3), [[0, 1, 1, 3]]),
        # Steps start exactly at an end point, and x may pass the other end within its pixel.
        ((0.9, 0.5, 2.1, 0.5), [[0, 0, 3, 1]]),
        ((0.0, 0.0, 3.0, 3.0), [[0, 0, 1, 1], [1, 1, 2, 2], [2, 2, 3, 3], [3, 3, 4, 4]]),
        ((0.5, 0.5, 4.5, 1.5), [[0, 0, 2, 1], [2, 1, 5, 2]]),
        ((0.5, 0.5, 1.5, 4.5), [[0, 0, 1, 2], [1, 2, 2, 5]]),
        ((0.5, 4.5, 1.5, 0.5), [[0, 3, 1, 5], [1, 0, 2, 3]]),
        ((-5.5, 2.5, 2.5, 2.5), [[0, 2, 3, 3]]),
        ((-5.5, -2.5, -2.5, -2.5), []),
        ((60.5, 3.5, 99.5, 3.5), [[60, 3, 64, 4]]),
    ],
)
def test_lines_by_hand(segment, rectangles):
    assert drawn(*segment).tolist() == rectangles


@given(COORDINATE, COORDINATE, COORDINATE, COORDINATE)
def test_any_line_follows_the_rule(x0, y0, x1, y1):
    wanted = [p for p in slow_line(x0, y0, x1, y1) if 0 <= p[0] < 64 and 0 <= p[1] < 48]
    pixels = pixels_of(drawn(x0, y0, x1, y1, height=48))
    assert len(pixels) == len(set(pixels))
    assert set(pixels) == set(wanted)


def test_many_lines_are_in_order():
    rng = np.random.default_rng(0)
    segments = rng.uniform(-40, 100, (400, 4)).astype(np.float32)
    rectangles, line = pixel_lines(segments, 64, 64)
    assert (np.diff(line) >= 0).all()
    for index, segment in enumerate(segments):
        wanted = {p for p in slow_line(*segment) if 0 <= p[0] < 64 and 0 <= p[1] < 64}
        assert set(pixels_of(rectangles[line == index])) == wanted


@given(
    st.floats(-(2.0**20), 2.0**20, width=32),
    st.floats(-2, 2, width=32).filter(lambda x: abs(x) > 1e-6),
    st.integers(0, 3000),
)
def test_advance_equals_repeated_addition(start, step, count):
    start, step = np.float32(start), np.float32(step)
    value = np.add.accumulate(np.append(start, np.full(count, step)), dtype=np.float32)
    sum_of_steps, done = advance(start, step, count)
    assert sum_of_steps == value[-1]
    assert done == count
    goal = float(value[-1])
    first = int(np.argmax(value >= goal if step > 0 else value <= goal))
    assert advance(start, step, 10**9, goal) == (value[first], first)


def test_advance_over_millions_of_steps_equals_repeated_addition():
    for start, step in ((-3e6, 0.3), (-7e6, 1.0), (5e6, -0.7), (-2.5, 1e-5), (-(2.0**23), 1.5)):
        start, step = np.float32(start), np.float32(step)
        count = 5_000_000
        value = np.add.accumulate(np.append(start, np.full(count, step)), dtype=np.float32)
        assert advance(start, step, count)[0] == value[-1]


@pytest.mark.parametrize(
    "segment",
    [
        (-40_000.3, -39_990.2, 70_000.9, 70_011.3),
        (-40_000.3, 90_000.1, 70_000.9, -70_011.3),
        (-400_000.0, 21.0, 900_000.0, 25.0),
        (31.3, -500_000.2, 33.1, 600_000.0),
        (31.3, 500_000.2, 33.1, -600_000.0),
        (7.5, 200_000.25, 7.5, -200_000.0),
        (-30.0, 900_000.0, 35.0, 10.0),
    ],
)
def test_long_lines_are_stepped_exactly(segment):
    wanted = {p for p in slow_line(*segment) if 0 <= p[0] < 64 and 0 <= p[1] < 64}
    assert set(pixels_of(drawn(*segment))) == wanted


def test_endless_lines_are_not_stepped_from_end_to_end():
    rng = np.random.default_rng(0)
    short = rng.uniform(0, 64, (302, 4)).astype(np.float32)
    far = rng.uniform(-1e9, 1e9, (300, 4)).astype(np.float32)
    huge = np.array([[-3e38, -3e38, 3e38, 3e38], [-1e9, 5.0, 1e9, 5.0]], np.float32)
    endless = np.concatenate([far, huge])
    of_short, of_endless = (
        count_calls(lambda lines=lines: pixel_lines(lines, 64, 64)) for lines in (short, endless)
    )
    # A line without end takes about 60 times as many calls as a short one. One call for each pixel
    # would be a million times as many.
    assert of_endless < 200 * of_short
    rectangles, _ = pixel_lines(endless, 64, 64)
    assert (rectangles >= 0).all() and (rectangles <= 64).all()
    # In float32, adding 1 beyond 2^24 changes nothing, so such a line never reaches the canvas.
    assert drawn(-1e9, 5.0, 1e9, 5.0).tolist() == []
    assert drawn(-1.6e7, 5.0, 1.6e7, 5.0).tolist() == [[0, 5, 64, 6]]
