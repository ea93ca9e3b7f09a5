"""Composites groups with opacity by geometry, as the renderer has no groups.

The shapes of a group are divided into cells that do not overlap. Each cell has the colour that the
composited group has there, so that the group's opacity can be multiplied into each cell. What an
opaque shape covers is cut out of the shapes below. Where a translucent shape lies over others, the
overlap becomes a separate cell. Its colour is exact if both shapes have a constant alpha and no
texture.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely

from ...budget import Budget
from ...shapes.regions import difference, grown, intersection, is_empty, united
from .paint import Paint, composite_paints

_GAP = 2.0**-10
"""Width, in pixels, of the gap between a shape in front and what is left of a shape behind it.

Samples often lie exactly on edges, where two cells that share the edge would both be blended. The
gap is about a twentieth of the tolerance of curves, which is 0.02 pixels.
"""


class Item(NamedTuple):
    """A shapely (multi)polygon in pixels, and its paint.

    - `source`: index in `Painter.sources` of the filled shape that the region belongs to; -1 if it
      does not belong to a fill, or if sources are not stored.
    - `family`: a number that items share if they are known not to overlap each other; -1 for an
      item that may overlap any other.
    """

    region: Any
    paint: Paint
    source: int = -1
    family: int = -1


def disjoint_cells(items: Sequence[Item], budget: Budget) -> tuple[list[Item], bool]:
    """Divide the items of a group into cells that do not overlap.

    `items` are in draw order, back to front, and their regions are not empty. Returns the cells,
    and whether all their colours are exact. A cell is an item too, and has the colours of the
    composited group before the group's opacity is applied. Colours may be inexact where a
    translucent item overlaps another one, if either has a texture or an alpha that varies. A gap of
    `_GAP` separates a cell from what is left of the items behind it. An item whose bounding box
    meets no other is returned unchanged. Raises `BudgetError` for work beyond the budget.
    """
    neighbours = _overlapping(items, budget)
    if not any(len(in_front) for in_front in neighbours):
        return list(items), True
    visible = _without_hidden(items, neighbours, budget)
    cells: list[list[Item]] = [[] for _ in items]
    items_behind: list[list[int]] = [[] for _ in items]
    for index, in_front in enumerate(neighbours):
        for later in in_front.tolist():
            items_behind[later].append(index)
    is_exact = True
    for index, item in enumerate(visible):
        uncovered = item.region
        if not item.paint.is_opaque:
            for behind in items_behind[index]:
                uncovered, is_blend_exact = _blend(item, uncovered, cells, behind, index, budget)
                is_exact &= is_blend_exact
        if not is_empty(uncovered):
            cells[index].append(item._replace(region=uncovered))
    return [cell for cells_of_item in cells for cell in cells_of_item], is_exact


def _overlapping(items: Sequence[Item], budget: Budget) -> list[np.ndarray]:
    """For each item, the sorted indices of the items in front whose bounding boxes meet its box.

    `items` are in draw order, back to front. Items of the same family (`Item.family`) are left out,
    since they do not overlap.
    """
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
    """Cut from each item what the opaque items in front of it hide.

    `neighbours` has, for each item, the indices of the items in front that may overlap it. A gap of
    `_GAP` around what hides it is cut away too. Returns one item for each of `items`, whose region
    may be empty.
    """
    visible = []
    # A stroke of many dashes often lies in front of several pieces of the fill behind it.
    covers: dict[tuple[int, ...], Any] = {}
    for item, in_front in zip(items, neighbours, strict=True):
        opaque = tuple(k for k in in_front.tolist() if items[k].paint.is_opaque)
        if opaque:
            if opaque not in covers:
                regions = [items[k].region for k in opaque]
                covers[opaque] = grown(united(regions, budget), _GAP, budget)
            item = item._replace(region=difference(item.region, covers[opaque], budget))
        visible.append(item)
    return visible


def _blend(
    item: Item,
    uncovered: Any,
    cells: list[list[Item]],
    behind: int,
    index: int,
    budget: Budget,
) -> tuple[Any, bool]:
    """Blend a translucent item over the cells of one item behind it, where it covers them.

    - `uncovered`: the part of the region of `item` that overlaps none of the items behind that were
      blended before.
    - `cells`: for each item, a list of its cells, which this function changes. Each overlap is
      appended to `cells[index]` with the blended colours, and removed from `cells[behind]` together
      with a gap of `_GAP` around it.
    - `behind`, `index`: indices in `cells` of the item behind, and of `item` itself.

    Returns the part of `uncovered` that covers neither a cell of the item behind nor the gap around
    an overlap, and whether the blended colours are exact.
    """
    remaining_cells, is_exact = [], True
    for cell in cells[behind]:
        common = intersection(cell.region, item.region, budget)
        if is_empty(common):
            remaining_cells.append(cell)
            continue
        points = shapely.get_coordinates(common)
        paint, is_paint_exact = composite_paints(item.paint, cell.paint, points)
        is_exact &= is_paint_exact
        cells[index].append(Item(common, paint, item.source))
        border = grown(common, _GAP, budget)
        remaining = difference(cell.region, border, budget)
        if not is_empty(remaining):
            remaining_cells.append(cell._replace(region=remaining))
        uncovered = difference(uncovered, border, budget)
    cells[behind] = remaining_cells
    return uncovered, is_exact
