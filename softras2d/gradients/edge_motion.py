"""How the image changes as edges move: sums over crossings, linear in the speeds of edges.

A crossing is a point where an edge crosses a line of samples (`crossings`). Its speed is the speed
at which it moves along this line. Speed times the jump of colour at the crossing is added to the
derivative of the crossing's pixel.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..numerics.fusion_barrier import materialized
from .runs import Sides


class Jumps(NamedTuple):
    """What the image gains as edges move, at the crossings of a list of runs (`runs.Runs`).

    - `edge`: the edge of each run, as 3 triangle + side. Side k runs from corner k to the next.
    - `t`: position of the crossing along the edge, from 0 at its start to 1 at its end.
    - `pixel`: index of the crossing's pixel, row by row; one past the last if it has none.
    - `jump`: change of the pixel's colour per pixel by which the crossing moves along its line,
      towards greater x or y; 0 where a crossing does not count. For a vjp it is the dot product of
      this change and the pixel's cotangent (`PixelCotangent`).
    """

    edge: Int[Array, " runs"]
    t: Float[Array, "lines runs"]
    pixel: Int[Array, "lines runs"]
    jump: Float[Array, "values lines runs"]


@materialized
def edge_speeds(
    velocity: Float[Array, "vertices 2"], vertex: Int[Array, "triangles 3"], sides: Sides
) -> Float[Array, "2 edges"]:
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

    return jnp.stack([speed(vertex), speed(jnp.roll(vertex, -1, 1))])


def add_to_image(
    image: list[Float[Array, " pixels"]], jumps: Jumps, speeds: Float[Array, "2 edges"]
) -> list[Float[Array, " pixels"]]:
    """Add the change of the image per unit of time, of all crossings in `jumps`, to `image`.

    The speed of a crossing is interpolated between the speeds at both ends of its edge. Speed times
    jump is added to the crossing's pixel.

    - `image`: one array for each channel. (In a single array, each sum would copy all channels.)
    - `speeds`: as returned by `edge_speeds`.
    """
    pixel = jumps.pixel.reshape(-1)
    change = materialized(_change)(jumps, speeds)
    return [
        channel.at[pixel].add(added.reshape(-1), mode="drop")
        for channel, added in zip(image, change, strict=True)
    ]


def _change(jumps: Jumps, speeds: Float[Array, "2 edges"]) -> Float[Array, "channels lines runs"]:
    """Compute speed times jump of each crossing, for each channel."""
    start, end = (speed[jumps.edge][None] for speed in speeds)
    return jumps.jump * (start * (1.0 - jumps.t) + end * jumps.t)[None]


def add_to_speeds(
    speeds: list[Float[Array, " edges"]], jumps: Jumps
) -> list[Float[Array, " edges"]]:
    """Add the contributions of all crossings in `jumps` to the cotangent of the speeds of edges.

    This is the transpose of `add_to_image`, which maps speeds to an image: `jumps.jump` is the dot
    product of the jump and the pixel's cotangent. `speeds` has the cotangents at the starts of all
    edges, and those at the ends.
    """
    contributions = materialized(_speed_cotangents)(jumps)
    return [
        speed.at[jumps.edge].add(added) for speed, added in zip(speeds, contributions, strict=True)
    ]


def _speed_cotangents(jumps: Jumps) -> tuple[Float[Array, " runs"], Float[Array, " runs"]]:
    """Compute the cotangents of the speeds at the start and at the end of each run's edge.

    They are summed over the crossings of the run.
    """
    (by_pixel,) = jumps.jump
    return jnp.sum(by_pixel * (1.0 - jumps.t), 0), jnp.sum(by_pixel * jumps.t, 0)


@materialized
def gather_cotangent(
    image: Float[Array, "channels pixels"], pixel: Int[Array, "lines runs"]
) -> Float[Array, "channels lines runs"]:
    """Gather the cotangent of each crossing's pixel; 0 for crossings without a pixel.

    `image` is the cotangent of the image.
    """
    # Any pixel's value would not do for crossings without one: it may be NaN.
    return jnp.stack([channel.at[pixel].get(mode="fill", fill_value=0) for channel in image])
