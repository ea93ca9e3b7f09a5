"""How the image changes as edges move, from what each crossing gains: a linear map.

The speed of a crossing is the speed at which the edge moves along the line of samples there. Speed
times the jump of colour is added to the derivative of the crossing's pixel.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..geometry.canvas_grid import Grid
from ..numerics.fusion_barrier import materialized
from .crossings import LINES, Sides


class Sweep(NamedTuple):
    """How the image changes when edges move, crossing by crossing.

    - `edge`, `t`, `pixel`: as in `Crossings`.
    - `jump`: derivative of the pixel's colour by the position of the crossing on its line of
      samples, per pixel of motion towards greater x or y.
    """

    edge: Int[Array, " runs"]
    t: Float[Array, "lines runs"]
    pixel: Int[Array, "lines runs"]
    jump: Float[Array, "channels lines runs"]


@materialized
def edge_speeds(
    velocity: Float[Array, "vertices 2"], vertex: Int[Array, "triangles 3"], sides: Sides
) -> tuple[Float[Array, " edges"], Float[Array, " edges"]]:
    """Speed of both ends of each edge along the lines of samples that it crosses."""
    slope = sides.slope

    def speed(vertex: Int[Array, "triangles 3"]) -> Float[Array, " edges"]:
        x, y = velocity[:, 0][vertex], velocity[:, 1][vertex]
        along, across = jnp.where(sides.steep, x, y), jnp.where(sides.steep, y, x)
        return (along - slope * across).reshape(-1)

    return speed(vertex), speed(jnp.roll(vertex, -1, 1))


def image_tangent(
    speeds: tuple[Float[Array, " edges"], Float[Array, " edges"]], sweep: Sweep, grid: Grid
) -> Float[Array, "height width channels"]:
    """Change of the image per unit of time as edges move. Linear in the speeds."""
    ends = materialized(_gather_speeds)(speeds, sweep.edge)
    speed = materialized(_interpolate)(materialized(_repeat_lines)(ends), sweep.t)
    add = materialized(functools.partial(_add_to_pixels, pixels=grid.height * grid.width))
    image = [add(speed, jump, sweep.pixel) for jump in sweep.jump]
    return jnp.stack(image, -1).reshape(grid.height, grid.width, -1)


def _gather_speeds(
    speeds: tuple[Float[Array, " edges"], Float[Array, " edges"]], edge: Int[Array, " runs"]
) -> tuple[Float[Array, " runs"], Float[Array, " runs"]]:
    """Speeds of the start and the end of each run's edge."""
    return speeds[0][edge], speeds[1][edge]


def _repeat_lines(
    ends: tuple[Float[Array, " runs"], Float[Array, " runs"]],
) -> tuple[Float[Array, "lines runs"], Float[Array, "lines runs"]]:
    """Copy the speeds to every line of a run."""
    # Not a broadcast: its transpose is a sum over lines that is not vectorised.
    start, end = (jnp.concatenate([end[None]] * LINES) for end in ends)
    return start, end


def _interpolate(
    ends: tuple[Float[Array, "lines runs"], Float[Array, "lines runs"]],
    t: Float[Array, "lines runs"],
) -> Float[Array, "lines runs"]:
    """Speed of each crossing, which lies at `t` between the ends of its edge."""
    start, end = ends
    return start * (1.0 - t) + end * t


def _add_to_pixels(
    speed: Float[Array, "lines runs"],
    jump: Float[Array, "lines runs"],
    pixel: Int[Array, "lines runs"],
    *,
    pixels: int,
) -> Float[Array, " pixels"]:
    """Add speed times jump of each crossing to its pixel; pixels past the last are dropped."""
    unchanged = jnp.zeros(pixels, speed.dtype)
    return unchanged.at[pixel.reshape(-1)].add((jump * speed).reshape(-1), mode="drop")
