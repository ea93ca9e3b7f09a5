"""The table of the option values that each fit family accepts.

This module does not load JAX, so that arguments can be checked before JAX is loaded.
"""

from typing import NamedTuple


class FamilyTraits(NamedTuple):
    """A row of the table of traits.

    - `shadings`, `default_shading`: values of the option `shading`.
    - `default_size`: pixels along the longer side of the fit if the option `size` is not given; a
      target with fewer is fitted at its size.
    - `min_triangles`: the smallest value of the option `triangles`.
    - `translucent`: whether the option `translucent` may be true.
    """

    shadings: tuple[str, ...]
    default_shading: str
    default_size: int
    min_triangles: int
    translucent: bool


TRAITS: dict[str, FamilyTraits] = {
    "layers": FamilyTraits(
        shadings=("flat", "gouraud"),
        default_shading="flat",
        default_size=256,
        min_triangles=1,
        translucent=True,
    ),
    "mesh": FamilyTraits(
        shadings=("flat", "gouraud", "linear"),
        default_shading="gouraud",
        default_size=1024,
        min_triangles=2,
        translucent=False,
    ),
}
"""The traits of each family, by the values of the option `family`."""
