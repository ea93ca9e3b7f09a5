"""Plans of views, which are stored so that panning and small zooms compile nothing.

A view is the part of an enlarged drawing that a canvas shows (`view.py`). A plan is the options and
the array sizes, called capacities, of a compiled program. The arrays are lists, for example of the
triangles in each tile of the canvas. A view outgrows a plan if it needs longer lists.

JAX compiles a program for each set of capacities. A view that moves needs lists of other lengths in
every frame, so the plan of one frame is used for as long as it is large enough, with another
origin.

Unused capacity costs time, so there are two kinds of plans. A tight plan is large enough for the
view that it is made for, and for others that need no longer lists. A plan with headroom is also
large enough for the same view at twice the zoom, and its lists are longer than both views need. It
cuts triangles at the guard band, because zooming moves most triangles past the band. A large canvas
is first drawn with a tight plan, while a plan with headroom is made and compiled in another thread
(`background.py`). A small canvas always has a plan with headroom.

Each octave of zoom, a factor of two, has a plan of its own. At first it is the plan of the nearest
octave, which is replaced when a view outgrows it.
"""

import math
from collections import OrderedDict
from collections.abc import Hashable, Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import numpy as np

from ..numerics.device import to_device
from ..planning.effects import GUARD_BAND
from ..planning.plan import Plan
from ..planning.size_classes import triangle_class
from ..rendering.modes import mode_of
from ..rendering.planner import plan as make_plan
from ..scene import Scene
from .settings import Settings
from .view import View

TIGHT_PLAN_PIXELS = 2**20
"""Number of pixels of a canvas from which its first plan is tight.

On smaller canvases, the unused capacity of a plan with headroom costs less than compiling twice.
"""

_HEADROOM = 1.25
"""Length of the lists of a plan with headroom, as a multiple of what its two views need.

The multiple doubles whenever a plan is outgrown, which a running fit does again and again.
"""

_MAX_HEADROOM = 5.0
"""Maximum of the multiple that starts with `_HEADROOM`."""

_MAX_PLANS = 64
"""Maximum number of plans that are stored."""

_MAX_MEMORY = 4 * 2**30
"""Maximum size, in bytes, of the arrays of a render; a view that needs more is refused."""


class ViewPlans:
    """Cache of the plans of recent views.

    The docstring of `plans.py` explains tight plans, headroom and octaves.
    """

    def __init__(self):
        self._plans: OrderedDict[tuple[Hashable, int], Plan] = OrderedDict()
        self._headroom: dict[tuple[Hashable, int], float] = {}

    def choose(
        self, scene: Scene, view: View, settings: Settings, grid_bits: int | None = None
    ) -> Plan:
        """Return a plan for this view, which may turn out to be too small.

        If there are plans for views of the same kind (`kind_of`), the plan of the nearest octave of
        zoom is returned; it is the one that may be too small. Otherwise a plan is made for this
        view: a tight one if the canvas has `TIGHT_PLAN_PIXELS` or more, else one with headroom. The
        plan is stored for the view's octave, and returned with the origin and the other array
        leaves of this view (`_at`). `grid_bits` is as in `softras2d.plan`.
        """
        kind, octave = kind_of(scene, view, settings, grid_bits), _octave(view)
        nearest_first = sorted(
            (abs(known_octave - octave), known_octave)
            for known_kind, known_octave in self._plans
            if known_kind == kind
        )
        if nearest_first:
            plan = self._plans[kind, nearest_first[0][1]]
        elif view.height * view.width >= TIGHT_PLAN_PIXELS:
            plan = _make_plan([scene], view, settings, grid_bits, headroom=1.0)
        else:
            return self.enlarge(scene, view, settings, grid_bits)
        self._keep((kind, octave), plan)
        return _at(plan, view, settings)

    def enlarge(
        self, scene: Scene, view: View, settings: Settings, grid_bits: int | None = None
    ) -> Plan:
        """Make a plan with more headroom for this view, and store it for the view's octave of zoom.

        The lists of the plan are 1.25 times as long as needed (`_HEADROOM`), or 2.5 times if
        `adopt` was called before for the same kind of views and octave. Each further call for that
        kind and octave doubles the factor, up to `_MAX_HEADROOM`. `grid_bits` is as in
        `softras2d.plan`.
        """
        key = kind_of(scene, view, settings, grid_bits), _octave(view)
        headroom = self._headroom.get(key, _HEADROOM)
        plan = headroom_plan(scene, view, settings, grid_bits, headroom)
        self._headroom[key] = min(2 * headroom, _MAX_HEADROOM)
        self._keep(key, plan)
        return plan

    def adopt(self, scene: Scene, view: View, settings: Settings, plan: Plan) -> Plan:
        """Store a plan with headroom that another thread has made, for the view's octave of zoom.

        `plan` is for the view's kind (`kind_of`). Returns the plan with the origin and the other
        array leaves of this view (`_at`). If a view outgrows the plan, the plan that `enlarge`
        makes next has lists that are 2.5 times as long as needed: twice `_HEADROOM`.
        """
        key = kind_of(scene, view, settings), _octave(view)
        self._headroom[key] = 2 * _HEADROOM
        self._keep(key, plan)
        return _at(plan, view, settings)

    def _keep(self, key: tuple[Hashable, int], plan: Plan) -> None:
        """Store a plan by `key`: its kind of views, and its octave of zoom.

        Beyond `_MAX_PLANS` plans, the plan that was chosen longest ago is dropped.
        """
        self._plans[key] = plan
        self._plans.move_to_end(key)
        while len(self._plans) > _MAX_PLANS:
            oldest, _ = self._plans.popitem(last=False)
            self._headroom.pop(oldest, None)


def headroom_plan(
    scene: Scene,
    view: View,
    settings: Settings,
    grid_bits: int | None = None,
    headroom: float = _HEADROOM,
) -> Plan:
    """Make a plan for a view and for the same view at twice the zoom, with headroom.

    `scene` is at the zoom of the view. The lists of the plan are at least `headroom` times as long
    as the two views need. This argument and `grid_bits` are as in `softras2d.plan`. Under sampled
    coverage, the plan cuts triangles at the guard band, even if no triangle of the view reaches it.
    """
    scenes = [scene, _at_twice_the_zoom(scene, view)]
    plan = _make_plan(scenes, view, settings, grid_bits, headroom)
    if GUARD_BAND in mode_of(plan.coverage).effects and not plan.cuts_far_triangles:
        plan = replace(plan, effects=(*plan.effects, GUARD_BAND))
    return plan


def _make_plan(
    scenes: Sequence[Scene],
    view: View,
    settings: Settings,
    grid_bits: int | None,
    headroom: float,
) -> Plan:
    """Make a plan that is large enough for each of some scenes on the canvas of a view.

    `headroom` and `grid_bits` are as in `softras2d.plan`. Raises `ValueError` if a render would
    take more than `_MAX_MEMORY`.
    """
    plan = make_plan(
        scenes,
        height=view.height,
        width=view.width,
        coverage=settings.coverage_option(),
        filter=settings.filter_option(),
        origin=(view.x, view.y),
        max_width=settings.planned_width(),
        grid_bits=grid_bits,
        headroom=headroom,
        # Such a program calls no host function, so that JAX can keep it on disk.
        on_overflow="nan",
    )
    if plan.memory > _MAX_MEMORY:
        raise ValueError(
            f"the view would take {plan.memory / 2**30:.1f} GiB: choose fewer samples, or a "
            "smaller window."
        )
    return plan


def _octave(view: View) -> int:
    """Octave of the zoom of a view: its binary logarithm, rounded."""
    return math.floor(math.log2(view.zoom) + 0.5)


def kind_of(scene: Scene, view: View, settings: Settings, grid_bits: int | None = None) -> Hashable:
    """A key that is the same for views that one plan can draw, if its capacities suffice.

    It depends on the structure of the scene, the dtype of its positions, the shapes of its colours,
    background and textures, and the number of triangles, rounded up to a size class; on the size of
    the canvas and `grid_bits`; and on `Settings.without_arrays`. It does not depend on zoom, offset
    and the number of vertices.
    """
    textures = scene.textures
    return (
        jax.tree.structure(scene),
        triangle_class(scene.triangles.shape[0]),
        scene.positions.dtype,
        scene.colors.shape[1:],
        scene.background.shape,
        None if textures is None else (textures.texels.shape, textures.levels.shape),
        (view.height, view.width, grid_bits),
        settings.without_arrays(),
    )


def _at_twice_the_zoom(scene: Scene, view: View) -> Scene:
    """The scene at twice the size, enlarged about the middle of the view's canvas."""
    positions = np.asarray(scene.positions)
    middle = np.array([view.x + view.width / 2, view.y + view.height / 2])
    moved = 2 * positions.astype(np.float64) - middle
    return eqx.tree_at(lambda scene: scene.positions, scene, moved.astype(positions.dtype))


def _at(plan: Plan, view: View, settings: Settings) -> Plan:
    """Return `plan` with the array leaves of a view and its settings.

    They are the origin, the bias of the level of detail and, under soft coverage, the width of soft
    edges. Changing them does not recompile.
    """
    wanted = eqx.tree_at(lambda plan: plan.origin, plan, _like([view.x, view.y], plan.origin))
    bias = _like(settings.lod_bias, plan.filter.lod_bias)
    wanted = eqx.tree_at(lambda plan: plan.filter.lod_bias, wanted, bias)
    if settings.coverage == "soft":
        soft: Any = plan.coverage
        width = _like(settings.soft_width, soft.width)
        wanted = eqx.tree_at(lambda plan: plan.coverage.width, wanted, width)
    return wanted


def _like(value: Any, leaf: Any) -> Any:
    """Put a value on the device, in the dtype of `leaf`."""
    return to_device(np.asarray(value, leaf.dtype))
