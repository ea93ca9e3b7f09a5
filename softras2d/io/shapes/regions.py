"""Intersects, unites and subtracts regions of the plane, charged to a budget.

A region is a shapely geometry. Operations may leave lines and points where regions touch; only
polygons are kept.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely

from ..budget import Budget
from .fill_rules import fill_rule_regions

EMPTY: Any = shapely.MultiPolygon()
"""The region without points."""


def filled(contours: Sequence[np.ndarray], evenodd: bool, budget: Budget) -> Any:
    """The region that a fill rule fills."""
    regions, _ = fill_rule_regions([contours], [evenodd], [0], budget)
    # Faces of one shape share edges, so that they are a region only once united.
    if len(regions) == 0:
        return EMPTY
    return shapely.disjoint_subset_union_all(regions) if len(regions) > 1 else regions[0]


def intersection(first: Any, second: Any, budget: Budget) -> Any:
    """The intersection of two regions."""
    _charge(budget, first, second)
    return polygons_of(shapely.intersection(first, second))


def difference(region: Any, removed: Any, budget: Budget) -> Any:
    """The difference of two regions: the first without the second."""
    _charge(budget, region, removed)
    return polygons_of(shapely.difference(region, removed))


def united(regions: Sequence[Any], budget: Budget) -> Any:
    """The region that any of the regions covers."""
    if len(regions) == 1:
        return regions[0]
    _charge(budget, *regions, weight=_COSTLY)
    return polygons_of(shapely.disjoint_subset_union_all(np.array(regions, object)))


def grown(region: Any, distance: float, budget: Budget) -> Any:
    """A region with its border moved outwards by a distance."""
    _charge(budget, region, weight=2 * _COSTLY)
    # One polygon at a time: GEOS 3.14 takes 23 s for 33,000 dashes at once, and 1 s like this.
    polygons = shapely.get_parts(region)
    larger = shapely.buffer(polygons, distance, join_style="mitre", mitre_limit=2.0)
    return shapely.disjoint_subset_union_all(larger) if len(larger) > 1 else larger[0]


def is_empty(region: Any) -> bool:
    """Whether a region has no area."""
    return bool(shapely.is_empty(region)) or float(shapely.area(region)) == 0.0


def polygons_of(geometry: Any) -> Any:
    """The polygons of a geometry as one region, without its lines and points."""
    if geometry.geom_type in ("Polygon", "MultiPolygon"):
        return geometry
    members = shapely.get_parts(geometry)
    areas = [member for member in members if member.geom_type in ("Polygon", "MultiPolygon")]
    if not areas:
        return EMPTY
    if len(areas) == 1:
        return areas[0]
    return shapely.multipolygons(np.concatenate([shapely.get_parts(area) for area in areas]))


_OPERATION = 128
"""Vertices that GEOS overlays in the time that the smallest operation takes."""

_COSTLY = 4
"""How many times as long a union or a larger border takes, per vertex, as an intersection."""


def _charge(budget: Budget, *regions: Any, weight: int = 1) -> None:
    count = int(shapely.get_num_coordinates(np.array(regions, object)).sum())
    budget.charge("overlays", _OPERATION + weight * count)
