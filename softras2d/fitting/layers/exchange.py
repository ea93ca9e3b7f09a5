"""Replace triangles by new ones in the arrays of a fit, whose lengths never change."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from ...numerics.device import to_device
from ..palette import Palette
from ..target import Image, Target
from ..units import POSITION_UNIT
from .placement import place, removal_costs
from .unknowns import LayersUnknowns

_EXPECTED_GAIN = 10.0
"""Expected gain of a new triangle once it is fitted, as a multiple of its gain when it is placed.
An exchange is made if the expected gain exceeds the cost of the removal."""

_NEW_OPACITY = 0.9
"""Opacity of new triangles in a fit of translucent ones."""


class Replacement(NamedTuple):
    """A new order of all triangles, in which some are then replaced by new flat triangles.

    - `order`: the old index of each triangle.
    - `first`: index, in the new order, of the first triangle to be replaced.
    - `corners`, `colors`: the new triangles, in pixels. They replace as many, from `first` on.
    """

    order: Int[np.ndarray, " triangles"]
    first: int
    corners: Float[np.ndarray, "new 3 2"]
    colors: Float[np.ndarray, "new 3"]

    def in_unknowns(self, y: LayersUnknowns) -> LayersUnknowns:
        """Replace triangles in the unknowns."""
        return LayersUnknowns(
            self._in_array(y.corners, self.corners / POSITION_UNIT),
            self._in_array(y.colors, self.colors[:, None]),
            None if y.opacity is None else self._in_array(y.opacity, _NEW_OPACITY),
        )

    def in_optimizer_state(self, state: Any) -> Any:
        """Reorder the arrays that have one entry per triangle; entries of new triangles are 0."""

        def reordered(leaf: Any) -> Any:
            is_per_triangle = (
                isinstance(leaf, jax.Array) and leaf.ndim and leaf.shape[0] == len(self.order)
            )
            return self._in_array(leaf, 0) if is_per_triangle else leaf

        return jax.tree.map(reordered, state)

    def _in_array(self, values: jax.Array, new: Any) -> jax.Array:
        """Reorder an array along its first axis, then set the entries of new triangles."""
        host = np.asarray(values)[self.order]
        host[self.first : self.first + len(self.corners)] = new
        return to_device(host)


def find_exchange(
    rng: np.random.Generator,
    y: LayersUnknowns,
    image: Image,
    target: Target,
    background: Float[np.ndarray, " channels"],
    count: int,
    *,
    active: int,
    size: float,
    palette: Palette | None = None,
) -> Replacement | None:
    """Move up to `count` of the triangles whose removal costs least to where they gain more.

    The moved triangles come in front of the other `active` ones. Only those move whose expected
    gain exceeds the cost of their removal; None if there are none.

    - `image`, `target`, `background`: premultiplied; `image` is that of the unknowns `y`.
    - `size`: typical circumradius of a new triangle, in pixels.
    - `palette`: the colours that a triangle may have; None: any.
    """
    length = len(y.corners)
    corners, colors, opacity = jax.tree.map(lambda leaf: np.asarray(leaf)[:active], y)
    costs = removal_costs(
        corners * POSITION_UNIT,
        np.clip(colors, 0, 1),
        None if opacity is None else np.clip(opacity, 0, 1),
        target,
        background,
    )
    new = place(rng, image, target, count, size=size, palette=palette)
    by_gain = np.argsort(-new.gains)
    by_cost = np.argsort(costs)[: len(by_gain)]
    moved = int(np.sum(_EXPECTED_GAIN * new.gains[by_gain] > costs[by_cost]))
    if moved == 0:
        return None
    removed, placed = by_cost[:moved], by_gain[:moved]
    staying, spare = np.setdiff1d(np.arange(active), removed), np.arange(active, length)
    order = np.concatenate([staying, removed, spare])
    return Replacement(order, active - moved, new.corners[placed], new.colors[placed])
