"""The interface of a coverage mode: how one kind of coverage is planned and drawn.

`modes.MODES` maps each option that a caller may choose to its mode. To add a mode, write its option
in `options.py`, where it also joins the union `Coverage`, write its class in a file of this folder,
and put both into `MODES`. A mode whose coverage is a smooth function of the corners derives from
`analytic.AnalyticMode`. The class names in `effects` the rows of `effects.EFFECTS` that a plan may
report for it.
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
    """Capacities and tile size of a plan.

    - `capacity`: maximum length of each list.
    - `tile_side`: pixels along a side of a square tile; 0 for the tiling of sampled coverage.
    - `lists_all`: whether every tile lists every triangle.
    """

    capacity: Capacity
    tile_side: int = 0
    lists_all: bool = False


class Listing(NamedTuple):
    """How the triangles of some scenes are listed: the input from which `layout` sizes the lists.

    - `tiling`: tiles of the canvas.
    - `headroom`: rule by which capacities follow from the list lengths that scenes need.
    - `unused`: fields of `Capacity` whose lists the scenes never need.
    - `count`: function that counts the entries of each list for a drawing of a concrete scene.
    - `tile_side`: pixels along a side of a square tile; 0 under sampled coverage.
    """

    tiling: Tiling
    headroom: Headroom
    unused: frozenset[str]
    count: Callable[[Drawing], Counts]
    tile_side: int = 0


class Growth(NamedTuple):
    """Margin by which later scenes may exceed the scenes that a plan is made for.

    - `factor`: every list may become this many times as long, 1 or more.
    - `is_worst_case`: whether the triangles may be anywhere and of any size; `factor` is then
      ignored.
    """

    factor: float = 1.0
    is_worst_case: bool = False


class Drawn(NamedTuple):
    """An image, and what shows whether the plan was large enough for it.

    - `image`: premultiplied as `CoverageMode.draw` returns it; `render` then divides by alpha.
    - `needs`: length of each list that the scene needed; triangles are missing from the image if
      one exceeds its capacity.
    - `leaves_guard_band`: whether a triangle reaches past the guard band although the plan does not
      cut triangles there; the image is then wrong.
    """

    image: Float[Array, "height width channels"]
    needs: Needs
    leaves_guard_band: Bool[Array, ""] | bool = False


class CoverageMode(abc.ABC):
    """How one kind of coverage is planned and drawn.

    - `effects`: names of the rows of `effects.EFFECTS` that this mode draws.
    - `missing`: for the name of each effect that this mode cannot draw, the one-line error message,
      which says what to do instead.
    """

    effects: frozenset[str]
    missing: dict[str, str]

    def prepare(self, coverage: Any, max_width: float | None) -> Coverage:
        """Check an option, and turn its numbers into arrays, which may change without recompiling.

        `max_width` is the argument of `plan`: the largest `Soft.width` to allow for, in pixels.
        Returns the new option. Raises `ValueError` for values that the option cannot have. By
        default an option has no numbers to turn into arrays, and refuses `max_width`.
        """
        if max_width is not None:
            raise ValueError("`max_width` is for Soft coverage.")
        return coverage

    def is_sum(self, coverage: Any) -> bool:
        """Whether signed areas are added, not composited, so that no triangle hides another."""
        return False

    def gradient_border(self, coverage: Any) -> int:
        """Pixels around a window of a larger canvas on which the window's gradient depends."""
        return 0

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

        - `drawings`: scenes of concrete arrays; with `growth.is_worst_case` only of array shapes.
        - `max_width`: largest `Soft.width` to allow for, in pixels; None for the option's width.
        - `tile_side`: pixels along a side of a tile under analytic coverage; by default the side of
          least work.
        """

    @abc.abstractmethod
    def draw(self, scene: Scene, plan: Plan, background: Float[Array, " channels"]) -> Drawn:
        """Draw a scene of at least one triangle over a premultiplied background.

        Implementations are pure functions, for use under any JAX transformation.
        """
