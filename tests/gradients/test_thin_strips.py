"""A strip thinner than the sample spacing shows what lies behind it, and no degenerate triangle."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

SIZE = 12
RED = [[-4, -4], [4.7, -4], [4.7, 60]]
GREEN = [[5.2, -4], [30, -4], [5.2, 60]]
BLUE = [[-40, -40], [80, -40], [-40, 80]]
"""Blue lies behind red and green, and shows in a strip between them, x in 4.7..5.2."""

DEGENERATE = {
    "on a row of samples": [[1.5, 6.5], [2.5, 6.5], [3.5, 6.5]],
    "on one sample": [[2.5, 6.5]] * 3,
}


def _change_as_red_moves(triangles: list, colors: list) -> np.ndarray:
    """Derivative of the image as the red triangle, which is among `triangles`, moves to the right.

    The triangles are in draw order.
    """
    scene = sr.Scene.from_soup(np.array(triangles, np.float32), np.array(colors, np.float32))
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=sr.Hard(samples=1))
    start = 3 * triangles.index(RED)
    velocity = jnp.zeros_like(scene.positions).at[start : start + 3, 0].set(1.0)
    draw = lambda positions: sr.render(replace(scene, positions=positions), plan)  # noqa: E731
    return np.asarray(jax.jvp(draw, (scene.positions,), (velocity,))[1])


@pytest.mark.parametrize("place", [1, 3])
@pytest.mark.parametrize("degenerate", DEGENERATE)
def test_a_triangle_without_area_shows_in_no_strip(degenerate, place):
    triangles, colors = [BLUE, RED, GREEN], [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    expected = _change_as_red_moves(triangles, colors)
    np.testing.assert_allclose(expected[6, 4], [1, 0, -1], atol=1e-6)
    triangles.insert(place, DEGENERATE[degenerate])
    colors.insert(place, [1, 1, 1])
    np.testing.assert_allclose(_change_as_red_moves(triangles, colors), expected, atol=1e-6)
