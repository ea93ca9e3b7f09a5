"""The interface of a coverage mode: how one kind of coverage is planned and drawn.

`modes.MODES` maps each option that a caller may choose to its mode. To add a mode, write its option
in `options.py` (an `eqx.Module` that has `rate` and `describe`, like `Soft`), where it also joins
the union `Coverage`; write its class in a file of this folder; and add the option and the class to
`MODES`. To make the option public, put its name into the lists of `softras2d/__init__.py`
and into `FACE` of `tests/test_public_face.py`. For the command line and the viewer, begin with
`names.CoverageKind`, and search for `"soft"` in `cli` and `viewing`.

A mode whose coverage is a smooth function of the corners derives from `analytic.AnalyticMode`. It
needs a subclass of `AnalyticCoverage` (`coverage.analytic`), in a file of `coverage`. For coverage
by distance, take the geometry from `SoftMode.slot_geometry`, the weights from `NearestWeights`, and
the nearest point from `coverage.soft.nearest_point`.

The class attribute `effects` of a mode names the rows of `effects.EFFECTS` that a plan may report
for the mode.
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
    """Capacities and tile size of a plan; `layout.choose_layout` chooses them.

    - `capacity`: maximum length of each list.
    - `tile_side`: pixels along a side of a square tile; 0 for the tiling of sampled coverage.
    - `lists_all`: whether every tile lists every triangle.
    """

    capacity: Capacity
    tile_side: int = 0
    lists_all: bool = False


class Listing(NamedTuple):
    """How triangles are put into tile lists, and how `layout` chooses the capacities of the lists.

    - `tiling`: tiles of the canvas.
    - `headroom`: rule by which capacities follow from the list lengths that scenes need.
    - `unused`: names of the fields of `Capacity` whose lists the scenes never need.
    - `count`: function that counts the entries of each list for a drawing of a concrete scene.
    - `tile_side`: pixels along a side of a square tile; 0 under sampled coverage.
    """

    tiling: Tiling
    headroom: Headroom
    unused: frozenset[str]
    count: Callable[[Drawing], Counts]
    tile_side: int = 0


class Growth(NamedTuple):
    """How far later scenes may exceed the scenes that a plan is made for.

    - `factor`: every list may become this many times as long, 1 or more.
    - `is_worst_case`: whether the triangles may be anywhere and of any size; `factor` is then
      ignored.
    """

    factor: float = 1.0
    is_worst_case: bool = False


class Drawn(NamedTuple):
    """An image, and the numbers that tell whether the plan was large enough for the scene.

    - `image`: the image; premultiplied in the result of `CoverageMode.draw`, and with straight
      alpha after `render` has divided by alpha.
    - `needs`: length of each list that the scene needed. If a length exceeds its capacity,
      triangles are missing from the image, or edges from its derivative (`Capacity.runs`).
    - `leaves_guard_band`: whether, under `Hard`, a triangle reaches past the guard band, a wide
      margin around the canvas, although the plan does not cut triangles there; the image is then
      wrong.
    """

    image: Float[Array, "height width channels"]
    needs: Needs
    leaves_guard_band: Bool[Array, ""] | bool = False


class CoverageMode(abc.ABC):
    """How one kind of coverage is planned and drawn.

    - `effects`: names of the rows of `effects.EFFECTS` that this mode draws.
    - `missing`: error messages by the name of an effect. It has an entry for each effect of a scene
      that this mode cannot draw, usually only "depth test". The message has one line, and says what
      to do instead. An effect in neither field is ignored without a message, such as the effects
      that stand for other coverage modes.
    """

    effects: frozenset[str]
    missing: dict[str, str]

    def prepare(self, coverage: Any, max_width: float | None) -> Coverage:
        """Check an option, and turn its numbers into arrays, which may change without recompiling.

        `coverage` is the option, such as `Soft(...)`. `max_width` is the argument of `plan`: the
        largest `Soft.width` to allow for, in pixels. Returns the new option. Raises `ValueError`
        for values that the option cannot have. By default an option has no numbers to turn into
        arrays, and refuses `max_width`.

        A mode with numbers overrides this method: it checks the numbers and `max_width`, and
        converts the numbers by `to_device(number, np.float32)`.
        """
        if max_width is not None:
            raise ValueError("`max_width` is for Soft coverage.")
        return coverage

    def is_sum(self, coverage: Any) -> bool:
        """Whether triangles are added with signed areas instead of composited; false by default.

        `coverage` is the option, such as `Area(...)`. If they are added, no triangle hides another.
        """
        return False

    def gradient_border(self, coverage: Any) -> int:
        """Width, in pixels, of the border that gradients of a window need; 0 by default.

        `coverage` is the option, such as `Hard(...)`. A window is a part of a larger canvas that is
        drawn by itself (`tiled`). Its gradient may depend on the pixels within this distance around
        it.
        """
        return 0

    def refuse_missing(self, drawings: Sequence[Drawing]) -> None:
        """Raise `ValueError` if a drawing has an effect that `missing` names.

        The error has the message that `missing` gives for the effect.
        """
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

        - `drawings`: one or more. Their scenes have concrete arrays, or only array shapes if
          `growth.is_worst_case`.
        - `max_width`: largest `Soft.width` to allow for, in pixels; None for the option's width.
        - `growth`: how far later scenes may exceed these. `Listing.count` does not include it.
        - `tile_side`: pixels along a side of a tile under analytic coverage; by default the side of
          least work. Ignored under sampled coverage.
        """

    @abc.abstractmethod
    def draw(self, scene: Scene, plan: Plan, background: Float[Array, " channels"]) -> Drawn:
        """Draw a scene of at least one triangle over a premultiplied background.

        Returns a premultiplied image with the channels of `background`. Implementations are pure
        functions, for use under any JAX transformation.
        """
