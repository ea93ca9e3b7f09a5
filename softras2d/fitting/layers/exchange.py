"""Exchange triangles: replace those that matter least by new ones, in arrays of fixed length."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from ...numerics.device import to_device
from ..palette import Palette
from ..target import Image, Target
from ..units import POSITION_UNIT
from .placement import find_new_triangles, removal_costs
from .unknowns import LayersUnknowns

_EXPECTED_GAIN = 10.0
"""Expected gain of a new triangle after it is fitted, as a multiple of its gain when it is added.

A gain is a fall of the squared error, and a cost is a rise (see `placement`). A triangle is
replaced by a new one if the expected gain of the new one exceeds the cost of removing the old one.
"""

_NEW_OPACITY = 0.9
"""Opacity of new triangles in a fit of translucent ones."""


class Replacement(NamedTuple):
    """A change of the triangles of a fit: they are reordered, then some are replaced by new ones.

    The order in the arrays is the draw order, back to front.

    - `order`: for each index in the new order, the index of the triangle in the old order, for all
      triangles in the arrays. Spare triangles, which are not in use, come last in both.
    - `first_replaced`: index, in the new order, of the first triangle that is replaced.
    - `corners`, `colors`: the new flat triangles, with corners in pixels of the fit and colours in
      0..1. They replace the triangles `first_replaced`, `first_replaced + 1`, and so on.
    """

    order: Int[np.ndarray, " triangles"]
    first_replaced: int
    corners: Float[np.ndarray, "new 3 2"]
    colors: Float[np.ndarray, "new 3"]

    def apply_to_unknowns(self, y: LayersUnknowns) -> LayersUnknowns:
        """Return the unknowns `y` with the triangles reordered and replaced.

        If `y` has opacities, the new triangles have the opacity `_NEW_OPACITY`.
        """
        return LayersUnknowns(
            self._in_array(y.corners, self.corners / POSITION_UNIT),
            self._in_array(y.colors, self.colors[:, None]),
            None if y.opacity is None else self._in_array(y.opacity, _NEW_OPACITY),
        )

    def apply_to_optimizer_state(self, state: Any) -> Any:
        """Return a solver's state with its arrays reordered as the triangles are.

        Only arrays change whose first axis has one entry for each triangle, spare ones included.
        The entries of new triangles become 0.
        """

        def replace_in_leaf(leaf: Any) -> Any:
            is_per_triangle = (
                isinstance(leaf, jax.Array) and leaf.ndim and leaf.shape[0] == len(self.order)
            )
            return self._in_array(leaf, 0) if is_per_triangle else leaf

        return jax.tree.map(replace_in_leaf, state)

    def _in_array(self, values: jax.Array, new: Any) -> jax.Array:
        """Reorder an array along its first axis, then set the entries of new triangles to `new`."""
        reordered = np.asarray(values)[self.order]
        reordered[self.first_replaced : self.first_replaced + len(self.corners)] = new
        return to_device(reordered)


def find_exchange(
    rng: np.random.Generator,
    y: LayersUnknowns,
    image: Image,
    target: Target,
    background: Float[np.ndarray, " channels"],
    count: int,
    *,
    active: int,
    circumradius: float,
    palette: Palette | None = None,
) -> Replacement | None:
    """Find up to `count` triangles to remove, and as many new ones to draw in front of all others.

    Triangles whose removal raises the squared error least are paired with the new triangles that
    lower the squared error most. A pair is exchanged if `_EXPECTED_GAIN` times the gain of the new
    triangle exceeds the cost of the removal; `placement` defines gain and cost. Returns None if no
    pair is exchanged.

    - `y`: the unknowns, in which frozen numbers have their fixed values.
    - `image`: the image of the unknowns `y`, premultiplied.
    - `target`, `background`: premultiplied, at the size of the fit.
    - `active`: number of triangles in use, which are the first ones of `y`.
    - `circumradius`: typical circumradius of a new triangle, in pixels of the fit.
    - `palette`: the colours that a new triangle may have; None: any colour.
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
    candidates = find_new_triangles(
        rng, image, target, count, circumradius=circumradius, palette=palette
    )
    by_gain = np.argsort(-candidates.gains)
    by_cost = np.argsort(costs)[: len(by_gain)]
    pair_count = int(np.sum(_EXPECTED_GAIN * candidates.gains[by_gain] > costs[by_cost]))
    if pair_count == 0:
        return None
    removed, added = by_cost[:pair_count], by_gain[:pair_count]
    staying, spare = np.setdiff1d(np.arange(active), removed), np.arange(active, length)
    order = np.concatenate([staying, removed, spare])
    return Replacement(
        order, active - pair_count, candidates.corners[added], candidates.colors[added]
    )
