"""Describes a radial gradient by circles of one colour each, and by rays that cross the circles.

Position 0 along the gradient is its start circle, and position 1 its end circle. Centers and radii
of the other circles are interpolated and extrapolated. If several circles pass through a point, the
circle with the largest position gives its colour (as in HTML, *createRadialGradient*).
"""

import math
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from .gradient_pieces import RadialGradient


@runtime_checkable
class Circles(Protocol):
    """The circles of one radial gradient, in the gradient's units, and rays that cross them.

    The position along the gradient is an affine function of the distance along each ray.
    """

    def rays(self, count: int) -> Float[np.ndarray, "rays 2"]:
        """Vectors for `count` or `count + 1` rays, in order of their angle.

        The rays run from one side of the area that the circles cover to its other side, or once
        around a circle. In the second case, the last ray equals the first. The vectors are
        arguments of `circle`.
        """
        ...

    def circle(self, position: float, rays: Float[np.ndarray, "rays 2"]) -> np.ndarray:
        """The points `[rays, 2]` at which rays meet the circle of a position.

        `rays` is a result of the method `rays`, and `position` is not below the lower bound that
        `span` returns. Points are in the gradient's units.
        """
        ...

    def span(self, points: Float[np.ndarray, "n 2"]) -> tuple[float, float]:
        """Lower and upper bound on the positions of the circles that are needed to paint an area.

        The area is the convex hull of `points`, in the gradient's units.
        """
        ...

    def largest_radius(self, position: float, points: Float[np.ndarray, "n 2"]) -> float:
        """Upper bound on the radii of the circles, up to a position, that paint an area.

        The area is the convex hull of `points`. The bound and `points` are in the gradient's units.
        """
        ...


class Cone(NamedTuple):
    """Circles of different radii, whose rays start at the apex, where the radius is zero.

    The scale of a circle is its radius divided by the radius of the end circle. Each ray from the
    apex meets each circle once or twice, and the nearer point is used.

    - `apex`: the point `[2]` at which the radius is zero.
    - `offset`: vector `[2]` from the apex to the center of the end circle.
    - `radius`: radius of the end circle.
    - `start_scale`: scale of the start circle, less than 1.
    """

    apex: np.ndarray
    offset: np.ndarray
    radius: float
    start_scale: float

    def rays(self, count: int) -> Float[np.ndarray, "rays 2"]:
        """Vectors from the apex to points of the end circle, in order of their angle.

        If the apex lies outside of the circles, all circles lie in a cone. There are then `count`
        rays, to the side of the end circle that faces the apex; the first and the last are the
        sides of the cone. Otherwise there are `count + 1` rays, which go once around the end
        circle, and the last equals the first.
        """
        distance = float(np.hypot(*self.offset))
        if distance > self.radius:
            half = math.acos(self.radius / distance)
            angle = _towards_start(self.offset) + half * np.linspace(-1.0, 1.0, count)
        else:
            # No ray is at a simple fraction of a turn, where samples may lie on it: the pieces on
            # both sides would be blended there.
            angle = 2 * math.pi * (np.arange(count + 1) + 0.618) / count
            angle[-1] = angle[0]
        return self.offset + self.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def circle(self, position: float, rays: Float[np.ndarray, "rays 2"]) -> np.ndarray:
        """The points `[rays, 2]` at which rays meet the circle of a position.

        `rays` is a result of the method `rays`.
        """
        return self.apex + (self.start_scale + (1.0 - self.start_scale) * position) * rays

    def span(self, points: Float[np.ndarray, "n 2"]) -> tuple[float, float]:
        """The positions along the gradient of the apex, and of a circle beyond all `points`.

        All rays meet this circle at least as far from the apex as the farthest of `points`, which
        are in the gradient's units. The two positions bound the circles that are needed to paint
        the convex hull of `points`.
        """
        shortest = abs(self.radius - float(np.hypot(*self.offset)))
        scale = self._farthest(points) / max(shortest, 1e-9)
        start = self.start_scale
        return -start / (1.0 - start), (scale - start) / (1.0 - start)

    def largest_radius(self, position: float, points: Float[np.ndarray, "n 2"]) -> float:
        """Upper bound on the radii of the circles, up to a position, that paint an area.

        The area is the convex hull of `points`. The bound and `points` are in the gradient's units.
        If the apex lies inside of the circles, the bound is attained by the circle of `position`,
        or by one through a point of the area.
        """
        scale = self.start_scale + (1.0 - self.start_scale) * position
        return self.radius * min(scale, self._largest_scale(points))

    def _largest_scale(self, points: Float[np.ndarray, "n 2"]) -> float:
        """Upper bound on the scales of the circles that paint the convex hull of `points`."""
        distance = float(np.hypot(*self.offset))
        if distance >= self.radius:
            # A circle is nearest to the apex where it crosses the axis of the cone.
            return self._farthest(points) / max(distance - self.radius, 1e-9)
        # In units of `radius`, a point p, relative to the apex, lies on the circle of scale s if
        # |p - s offset| = s. This s is a convex function of p, so it is largest at a vertex.
        with np.errstate(all="ignore"):
            vectors, offset = (points - self.apex) / self.radius, self.offset / self.radius
            along, squared = vectors @ offset, (vectors**2).sum(axis=1)
            difference = 1.0 - float(offset @ offset)
            root = np.sqrt(along**2 + difference * squared)
            # Both forms are the same value, but each is free of cancellation for one sign only.
            scales = np.where(along > 0, squared / (root + along), (root - along) / difference)
        return float(scales.max()) if np.isfinite(scales).all() else math.inf

    def _farthest(self, points: Float[np.ndarray, "n 2"]) -> float:
        """Distance from the apex to the farthest of `points`."""
        return float(np.hypot(*(points - self.apex).T).max())


class Tube(NamedTuple):
    """Circles of the same radius, whose rays are parallel.

    - `start_center`: center `[2]` of the start circle.
    - `axis`: vector `[2]` from `start_center` to the center of the end circle, not zero.
    - `radius`: radius of all circles.
    """

    start_center: np.ndarray
    axis: np.ndarray
    radius: float

    def rays(self, count: int) -> Float[np.ndarray, "rays 2"]:
        """Vectors from a circle's center to `count` points of the half circle that faces the start.

        The vectors are in order of their angle, and the same for all circles.
        """
        angle = _towards_start(self.axis) + math.pi / 2 * np.linspace(-1.0, 1.0, count)
        return self.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)

    def circle(self, position: float, rays: Float[np.ndarray, "rays 2"]) -> np.ndarray:
        """The points `[rays, 2]` at which rays meet the circle of a position.

        `rays` is a result of the method `rays`.
        """
        return self.start_center + position * self.axis + rays

    def span(self, points: Float[np.ndarray, "n 2"]) -> tuple[float, float]:
        """Positions of a half circle before all `points`, and of one behind all of them.

        Both are positions along the gradient, and bound the circles that are needed to paint the
        convex hull of `points`, which are in the gradient's units.
        """
        squared = float(self.axis @ self.axis)
        along = (points - self.start_center) @ self.axis / squared
        return float(along.min()), float(along.max()) + self.radius / math.sqrt(squared)

    def largest_radius(self, position: float, points: Float[np.ndarray, "n 2"]) -> float:
        """The radius of every circle, whatever the arguments are."""
        return self.radius


def circles_of(gradient: RadialGradient) -> Circles:
    """The circles of a radial gradient: a `Tube` if both radii are equal, otherwise a `Cone`.

    The end circle must not be smaller than the start circle, and the two must differ.
    """
    growth = gradient.radius - gradient.focal_radius
    focus, center = np.array(gradient.focus), np.array(gradient.center)
    if growth == 0:
        return Tube(focus, center - focus, gradient.radius)
    apex = focus - (center - focus) * (gradient.focal_radius / growth)
    return Cone(apex, center - apex, gradient.radius, gradient.focal_radius / gradient.radius)


def _towards_start(axis: np.ndarray) -> float:
    """The angle, in radians, of the direction opposite to `axis`, towards the start circle."""
    return math.atan2(-axis[1], -axis[0])
