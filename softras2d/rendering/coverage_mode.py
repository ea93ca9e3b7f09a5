"""The interface of a coverage mode: how one kind of coverage is planned and drawn.

`modes.MODES` maps each option that a caller may choose to its mode. To add a mode, write its option
in `options.py` and its class in a file of this folder (a smooth function of the corners: on
`analytic.AnalyticMode`), and put both into `MODES`. The effects that a plan reports for it are
rows of `effects.EFFECTS`, which the class names in `effects`.
"""

import abc
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from jaxtyping import Array, Bool, Float

from ..geometry.tiling import Tiling
from ..options import Coverage
from ..planning.capacities import Capacity, Headroom, Needs
from ..planning.effects import EFFECTS, Drawing
from ..planning.list_counts import Counts
from ..planning.plan import Plan
from ..scene import Scene


class Layout(NamedTuple):
    """Capacities and tiling that a plan takes from concrete scenes.

    - `capacity`: lengths of the lists.
    - `tile_side`: pixels along a square tile; 0 for the tiling of sampled coverage.
    - `lists_all`: whether every tile lists every triangle.
    """

    capacity: Capacity
    tile_side: int = 0
    lists_all: bool = False


class Listing(NamedTuple):
    """Inputs of the layout of the lists besides the scenes.

    - `unused`: names of the lists of `Capacity` that the scenes never need.
    - `count`: counts the lists of a drawing of a concrete scene.
    - `side`: pixels along a square tile; 0 under sampled coverage.
    """

    tiling: Tiling
    headroom: Headroom
    unused: frozenset[str]
    count: Callable[[Drawing], Counts]
    side: int = 0


class Growth(NamedTuple):
    """Margin by which later scenes may exceed the scenes that a plan is made for.

    - `factor`: every list may become this many times as long.
    - `is_worst_case`: whether the triangles may be anywhere and of any size.
    """

    factor: float = 1.0
    is_worst_case: bool = False


class Drawn(NamedTuple):
    """A premultiplied image, and whether the plan was large enough for it.

    - `needs`: the capacities that the scene needed.
    - `leaves_guard_band`: whether a triangle reaches past the guard band, which the plan did not
      foresee.
    """

    image: Float[Array, "height width channels"]
    needs: Needs
    leaves_guard_band: Bool[Array, ""] | bool = False


class CoverageMode(abc.ABC):
    """How one kind of coverage is planned and drawn.

    - `effects`: names of the rows of `effects.EFFECTS` that this mode draws.
    - `missing`: for each effect of a scene that it cannot draw, one line that says what to do.
    """

    effects: frozenset[str]
    missing: dict[str, str]

    def prepare(self, coverage: Any, max_width: float | None) -> Coverage:
        """Turn numbers of an option into arrays, whose values may change without compiling.

        Raises `ValueError` for values that the option cannot have. By default an option has no
        array leaves, and refuses `max_width`.
        """
        if max_width is not None:
            raise ValueError("`max_width` is for Soft coverage.")
        return coverage

    def refuse_missing(self, drawings: Sequence[Drawing]) -> None:
        """Raise `ValueError` if a drawing has an effect that the mode cannot draw."""
        for name, advice in self.missing.items():
            if any(map(EFFECTS[name].is_present, drawings)):
                raise ValueError(advice)

    @abc.abstractmethod
    def list_needs(
        self,
        drawings: Sequence[Drawing],
        max_width: float | None,
        growth: Growth,
        tile_side: int | None = None,
    ) -> Listing:
        """Choose tiling and headroom for drawings of one canvas size, and how to count their lists.

        `tile_side`: pixels along a tile under analytic coverage; unless given, the side of least
        work. In the worst case only the shapes of the scenes are known; otherwise they are
        concrete.
        """

    @abc.abstractmethod
    def draw(self, scene: Scene, plan: Plan, background: Float[Array, " channels"]) -> Drawn:
        """Draw a scene of at least one triangle; `background` is premultiplied.

        Pure, for use under any JAX transformation.
        """
