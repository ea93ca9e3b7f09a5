"""The grid of a canvas refuses sizes that are no numbers of pixels."""

import pytest

from softras2d.geometry.canvas_grid import Grid


def test_sizes_of_a_canvas_are_integers_in_range():
    for height, message in (
        (0, "`height` must be an integer of 1 or more; got 0"),
        (True, "`height` must be an integer of 1 or more; got True"),
        (16385, r"`height` and `width` must be in 1\.\.16384; got 16385 and 9"),
    ):
        with pytest.raises(ValueError, match=message):
            Grid.for_canvas(height, 9, 4)
    assert Grid.for_canvas(16384, 9, 4).height == 16384
