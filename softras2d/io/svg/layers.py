"""Composites groups with opacity by geometry, as the renderer has no groups.

The shapes of a group are divided into cells that do not overlap, each with the colour of the whole
group there. The group's opacity can then be multiplied into each cell. What an opaque shape covers
is cut out of the shapes below. Where a translucent shape lies over others, the overlap becomes a
cell of its own. Its colour is exact unless the alpha of both varies, or one has a texture.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely

from ..budget import Budget
from ..shapes.regions import difference, grown, intersection, is_empty, united
from .paint import Paint, over

_GAP = 2.0**-10
"""Width, in pixels, by which a shape is cut farther than the shape above it reaches.

Samples often lie exactly on edges, where two cells that share the edge would both be blended. The
gap is a twentieth of the tolerance of curves.
"""


class Item(NamedTuple):
    """A region with a paint, in pixels.

    - `source`: index of the shape that it is a part of, or -1.
    - `family`: number that it shares with other items that are known not to overlap it.
    """

    region: Any
    paint: Paint
    source: int = -1
    family: int = -1


def flattened(items: Sequence[Item], budget: Budget) -> tuple[list[Item], bool]:
    """Divide the items of a group, in draw order, into cells that do not overlap.

    Returns also whether all colours are exact.
    """
    neighbours = _overlapping(items, budget)
    if not any(len(above) for above in neighbours):
        return list(items), True
    visible = _without_hidden(items, neighbours, budget)
    cells: list[list[Item]] = [[] for _ in items]
    below: list[list[int]] = [[] for _ in items]
    for index, above in enumerate(neighbours):
        for higher in above.tolist():
            below[higher].append(index)
    is_exact = True
    for index, item in enumerate(visible):
        rest = item.region
        if not item.paint.is_opaque:
            for lower in below[index]:
                rest, exact = _blend(item, rest, cells, lower, index, budget)
                is_exact &= exact
        if not is_empty(rest):
            cells[index].append(item._replace(region=rest))
    return [cell for group in cells for cell in group], is_exact


def _overlapping(items: Sequence[Item], budget: Budget) -> list[np.ndarray]:
    """For each item, the later ones of other families whose bounding boxes overlap its own."""
    regions = np.array([item.region for item in items], object)
    boxes = shapely.bounds(regions)
    tree = shapely.STRtree(shapely.box(*boxes.T))
    families = np.array([item.family for item in items])
    neighbours = []
    for index, box in enumerate(shapely.box(*boxes.T)):
        nearby = tree.query(box)
        budget.charge("overlays", len(nearby))
        is_later = nearby > index
        is_later &= (families[nearby] != families[index]) | (families[index] < 0)
        neighbours.append(np.sort(nearby[is_later]))
    return neighbours


def _without_hidden(
    items: Sequence[Item], neighbours: list[np.ndarray], budget: Budget
) -> list[Item]:
    """The items without the parts that opaque items above them hide."""
    visible = []
    # A stroke of many dashes often lies above several pieces of the fill below it.
    covers: dict[tuple[int, ...], Any] = {}
    for item, above in zip(items, neighbours, strict=True):
        hiding = tuple(k for k in above.tolist() if items[k].paint.is_opaque)
        if hiding:
            if hiding not in covers:
                regions = [items[k].region for k in hiding]
                covers[hiding] = grown(united(regions, budget), _GAP, budget)
            item = item._replace(region=difference(item.region, covers[hiding], budget))
        visible.append(item)
    return visible


def _blend(
    item: Item, rest: Any, cells: list[list[Item]], lower: int, index: int, budget: Budget
) -> tuple[Any, bool]:
    """Move what `item` covers of the cells of `lower` to those of `index`, blended.

    Returns the part `rest` of the item that covers none of them, and whether colours are exact.
    """
    uncovered, is_exact = [], True
    for cell in cells[lower]:
        common = intersection(cell.region, item.region, budget)
        if is_empty(common):
            uncovered.append(cell)
            continue
        paint, exact = over(item.paint, cell.paint, shapely.get_coordinates(common))
        is_exact &= exact
        cells[index].append(Item(common, paint, item.source))
        border = grown(common, _GAP, budget)
        remaining = difference(cell.region, border, budget)
        if not is_empty(remaining):
            uncovered.append(cell._replace(region=remaining))
        rest = difference(rest, border, budget)
    cells[lower] = uncovered
    return rest, is_exact
