"""Compiles plans with headroom in a separate thread, while tight plans draw.

A plan is the options and the array sizes of a compiled program. `plans.py` explains tight plans,
headroom and kinds of views.
"""

from collections import OrderedDict
from collections.abc import Hashable
from concurrent.futures import Future, ThreadPoolExecutor

import jax

from ..planning.plan import Plan
from ..rendering.render import render_checked
from ..scene import Scene
from .plans import headroom_plan
from .settings import Settings
from .view import View

_MAX_PLANS = 16
"""Maximum number of plans that are stored, one for each kind of views (`plans.kind_of`)."""


class PlanCompiler:
    """Makes plans with headroom and compiles their programs, in a separate thread.

    A plan with headroom is large enough for its view and for the same view at twice the zoom. When
    Python ends, it waits for the thread, since it must not end while XLA compiles.
    """

    def __init__(self):
        self._thread = ThreadPoolExecutor(1, "softras2d compiler")
        self._plans: OrderedDict[Hashable, Future[Plan]] = OrderedDict()
        self._is_closed = False

    def start(self, kind: Hashable, scene: Scene, view: View, settings: Settings) -> None:
        """Begin to make a plan with headroom (`plans.headroom_plan`) for a view, and compile it.

        `kind` is the result of `plans.kind_of` for this view; `take` returns the plan of a kind. If
        the plan of this kind was requested before and not dropped since, or after `close`, nothing
        is begun. Otherwise plans of other kinds that are still waiting are dropped; whoever needs
        such a plan requests it again. The oldest plan is dropped, too, if there are more than
        `_MAX_PLANS`.
        """
        if kind in self._plans or self._is_closed:
            return
        for cancelled_kind in [kind for kind, plan in self._plans.items() if plan.cancel()]:
            del self._plans[cancelled_kind]
        self._plans[kind] = self._thread.submit(_compile, scene, view, settings)
        while len(self._plans) > _MAX_PLANS:
            self._plans.popitem(last=False)

    def take(self, kind: Hashable) -> Plan | None:
        """Wait until the plan of a kind of views is made and compiled, and return it.

        `kind` is a result of `plans.kind_of`. The plan stays stored. Returns None if the plan was
        not requested, was dropped (`start`, `close`), or cannot be made.
        """
        plan = self._plans.get(kind)
        try:
            return None if plan is None else plan.result()
        except Exception:
            return None

    def is_busy(self) -> bool:
        """Whether a plan is being made or compiled, or is waiting for that."""
        return not all(plan.done() for plan in self._plans.values())

    def close(self) -> None:
        """Wait for the program that is being compiled; drop the plans that are still waiting."""
        self._is_closed = True
        self._thread.shutdown(cancel_futures=True)


def _compile(scene: Scene, view: View, settings: Settings) -> Plan:
    """Make the plan with headroom of a view, compile its program by a first render, and return it.

    The plan is that of `plans.headroom_plan`. `scene` is at the zoom of the view.
    """
    plan = headroom_plan(scene, view, settings)
    # The program of a call is cached for later calls; a program compiled ahead of time is not.
    jax.block_until_ready(render_checked(scene, plan))
    return plan
