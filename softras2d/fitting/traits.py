"""The table of the option values that each fit family accepts.

This module does not load JAX, so that arguments can be checked before JAX is loaded.
"""

from typing import NamedTuple


class FamilyTraits(NamedTuple):
    """The option values that one fit family, `"layers"` or `"mesh"`, accepts: a row of `TRAITS`.

    - `shadings`, `default_shading`: the values of the option `shading`, and its default.
    - `default_size`: pixels along the longer side of the image during the fit, if the option `size`
      is not given. A smaller target is fitted at its own size.
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
"""The traits of each family, by the name that the option `family` accepts."""
