"""The circles along which a radial gradient has one colour each, and the rays that cross them.

Position 0 along the gradient is its start circle, and position 1 its end circle. Centers and radii
of the other circles are interpolated and extrapolated. If several circles pass through a point, the
one with the largest position gives its colour (as in HTML, *createRadialGradient*).
"""

import math
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from .gradient_pieces import RadialGradient


@runtime_checkable
class Circles(Protocol):
    """The circles of one gradient, in its units.

    Along each ray, the position is an affine function of the distance.
    """

    def rays(self, count: int) -> Float[np.ndarray, "rays 2"]:
        """Offsets of about `count` rays, from one side to the other, or once around the circle."""
        ...

    def circle(self, position: float, rays: Float[np.ndarray, "rays 2"]) -> np.ndarray:
        """The points `[rays, 2]` at which rays meet the circle of a position."""
        ...

    def span(self, points: Float[np.ndarray, "n 2"]) -> tuple[float, float]:
        """Bounds of the positions at which circles cover the convex hull of points."""
        ...

    def largest_radius(self, position: float, points: Float[np.ndarray, "n 2"]) -> float:
        """Upper bound on the radii of circles up to `position` that are visible at `points`."""
        ...


class Cone(NamedTuple):
    """Circles of different radii, whose rays start at the apex, where the radius is zero.

    The circle at scale 1 is the end circle. Each ray from the apex meets the circle at scale s once
    or twice. The nearer point is used.

    - `apex`: where the radius is zero. `offset`: from there to the center of the end circle.
    - `radius`: of the end circle. `start`: the scale of the start circle.
    """

    apex: np.ndarray
    offset: np.ndarray
    radius: float
    start: float

    def rays(self, count: int) -> Float[np.ndarray, "rays 2"]:
        """Points of the end circle, relative to the apex.

        If the apex lies outside of all circles, they touch a cone from inside, and the first and
        the last ray are its sides.
        """
        distance = float(np.hypot(*self.offset))
        if distance > self.radius:
            half = math.acos(self.radius / distance)
            angle = _towards_start(self.offset) + half * np.linspace(-1.0, 1.0, count)
        else:
            # Not at simple fractions of a turn, as samples on a border would be blended twice.
            angle = 2 * math.pi * (np.arange(count + 1) + 0.618) / count
            angle[-1] = angle[0]
        return self.offset + self.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def circle(self, position: float, rays: Float[np.ndarray, "rays 2"]) -> np.ndarray:
        """The points `[rays, 2]` at which rays meet the circle of a position."""
        return self.apex + (self.start + (1.0 - self.start) * position) * rays

    def span(self, points: Float[np.ndarray, "n 2"]) -> tuple[float, float]:
        """Positions of the apex, and of a circle around all points that the cone reaches."""
        shortest = abs(self.radius - float(np.hypot(*self.offset)))
        scale = self._farthest(points) / max(shortest, 1e-9)
        return -self.start / (1.0 - self.start), (scale - self.start) / (1.0 - self.start)

    def largest_radius(self, position: float, points: Float[np.ndarray, "n 2"]) -> float:
        """Upper bound on the radius up to a position, of the circles that matter at points."""
        reached = min(self._farthest(points), self.radius * position)
        return max(self.radius * min(position, 1.0), reached)

    def _farthest(self, points: Float[np.ndarray, "n 2"]) -> float:
        """Distance of the farthest point from the apex."""
        return float(np.hypot(*(points - self.apex).T).max())


class Tube(NamedTuple):
    """Circles of the same radius, whose rays are parallel.

    - `start`: center of the start circle. `axis`: from there to the center of the end circle.
    """

    start: np.ndarray
    axis: np.ndarray
    radius: float

    def rays(self, count: int) -> Float[np.ndarray, "rays 2"]:
        """Points of the half of a circle that faces the start, relative to its center."""
        angle = _towards_start(self.axis) + math.pi / 2 * np.linspace(-1.0, 1.0, count)
        return self.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def circle(self, position: float, rays: Float[np.ndarray, "rays 2"]) -> np.ndarray:
        """The points `[rays, 2]` at which rays meet the circle of a position."""
        return self.start + position * self.axis + rays

    def span(self, points: Float[np.ndarray, "n 2"]) -> tuple[float, float]:
        """Positions of a half circle before all points, and of one behind them."""
        squared = float(self.axis @ self.axis)
        along = (points - self.start) @ self.axis / squared
        return float(along.min()), float(along.max()) + self.radius / math.sqrt(squared)

    def largest_radius(self, position: float, points: Float[np.ndarray, "n 2"]) -> float:
        """The radius of every circle."""
        return self.radius


def circles_of(gradient: RadialGradient) -> Circles:
    """The circles of a gradient whose end circle is not smaller than its start circle."""
    growth = gradient.radius - gradient.focal_radius
    focus, center = np.array(gradient.focus), np.array(gradient.center)
    if growth == 0:
        return Tube(focus, center - focus, gradient.radius)
    apex = focus - (center - focus) * (gradient.focal_radius / growth)
    return Cone(apex, center - apex, gradient.radius, gradient.focal_radius / gradient.radius)


def _towards_start(axis: np.ndarray) -> float:
    """The angle of the direction from the center of the end circle to that of the start circle."""
    return math.atan2(-axis[1], -axis[0])
