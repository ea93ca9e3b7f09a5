"""The change of the image as edges move: a linear map from the velocities of the vertices.

A crossing is a point where an edge crosses a line of samples (`crossings`). Its speed is the speed
at which it moves along this line. Speed times the jump of colour at the crossing is added to the
derivative of the crossing's pixel.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..geometry.canvas_grid import Grid
from ..numerics.fusion_barrier import materialized
from .crossings import LINES, Sides


class Sweep(NamedTuple):
    """How the image changes when edges move, for every crossing of an edge with a line of samples.

    - `edge`: the edge of each run of crossings, as 3 triangle + side.
    - `t`: position of the crossing along the edge, from 0 at its start to 1 at its end.
    - `pixel`: index of the crossing's pixel, row by row; one past the last if it has none.
    - `jump`: change of the pixel's colour per pixel by which the crossing moves along its line,
      towards greater x or y; 0 where a crossing does not count.
    """

    edge: Int[Array, " runs"]
    t: Float[Array, "lines runs"]
    pixel: Int[Array, "lines runs"]
    jump: Float[Array, "channels lines runs"]


@materialized
def edge_speeds(
    velocity: Float[Array, "vertices 2"], vertex: Int[Array, "triangles 3"], sides: Sides
) -> tuple[Float[Array, " edges"], Float[Array, " edges"]]:
    """Speeds, in pixels per unit of time, of crossings at the start and at the end of each edge.

    A crossing stays on its line of samples, a row for steep edges and a column for others. So its
    speed at one end of the edge is the velocity of this end along the line, minus the slope of the
    edge times the velocity of this end across the lines. It is positive towards greater x or y.
    Returns the speeds at the starts of all edges, then at the ends of all edges, with edges
    numbered 3 triangle + side.

    - `velocity`: velocity of the vertices, in pixels per unit of time.
    - `vertex`: vertex index of each corner of the reoriented triangles, in the order of `sides`.
    - `sides`: the ends of all edges.
    """
    slope = sides.slope

    def speed(vertex: Int[Array, "triangles 3"]) -> Float[Array, " edges"]:
        x, y = velocity[:, 0][vertex], velocity[:, 1][vertex]
        along, across = jnp.where(sides.steep, x, y), jnp.where(sides.steep, y, x)
        return (along - slope * across).reshape(-1)

    return speed(vertex), speed(jnp.roll(vertex, -1, 1))


def image_tangent(
    speeds: tuple[Float[Array, " edges"], Float[Array, " edges"]], sweep: Sweep, grid: Grid
) -> Float[Array, "height width channels"]:
    """Change of the image per unit of time as edges move, linear in the speeds of crossings.

    The speed of a crossing is interpolated between the speeds at both ends of its edge. Speed times
    jump is added to the crossing's pixel. `speeds` are as returned by `edge_speeds`.
    """
    ends = materialized(_gather_speeds)(speeds, sweep.edge)
    speed = materialized(_interpolate)(materialized(_repeat_lines)(ends), sweep.t)
    add = materialized(functools.partial(_add_to_pixels, pixels=grid.height * grid.width))
    image = [add(speed, jump, sweep.pixel) for jump in sweep.jump]
    return jnp.stack(image, -1).reshape(grid.height, grid.width, -1)


def _gather_speeds(
    speeds: tuple[Float[Array, " edges"], Float[Array, " edges"]], edge: Int[Array, " runs"]
) -> tuple[Float[Array, " runs"], Float[Array, " runs"]]:
    """Gather the speeds of `edge_speeds`, at the start and at the end, for each run's edge."""
    return speeds[0][edge], speeds[1][edge]


def _repeat_lines(
    ends: tuple[Float[Array, " runs"], Float[Array, " runs"]],
) -> tuple[Float[Array, "lines runs"], Float[Array, "lines runs"]]:
    """Repeat the speeds at both ends of each run's edge for every line of the run."""
    # Not a broadcast: its transpose is a sum over lines that is not vectorised.
    start, end = (jnp.concatenate([end[None]] * LINES) for end in ends)
    return start, end


def _interpolate(
    ends: tuple[Float[Array, "lines runs"], Float[Array, "lines runs"]],
    t: Float[Array, "lines runs"],
) -> Float[Array, "lines runs"]:
    """Speed of each crossing, from the speeds at the start and at the end of its edge.

    The crossing lies at the fraction `t` (0..1) along the edge.
    """
    start, end = ends
    return start * (1.0 - t) + end * t


def _add_to_pixels(
    speed: Float[Array, "lines runs"],
    jump: Float[Array, "lines runs"],
    pixel: Int[Array, "lines runs"],
    *,
    pixels: int,
) -> Float[Array, " pixels"]:
    """Sum speed times jump over the crossings of each pixel, for one channel.

    Crossings whose `pixel` is past the last are dropped.
    """
    unchanged = jnp.zeros(pixels, speed.dtype)
    return unchanged.at[pixel.reshape(-1)].add((jump * speed).reshape(-1), mode="drop")
