"""`value_and_grad_replanning`: a gradient that plans again when a scene outgrows its plan."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import numpy as np

from ..numerics.device import is_traced
from ..options import Coverage, Filter
from ..planning.plan import Plan
from ..scene import Scene
from .planner import plan


def value_and_grad_replanning(
    loss: Callable[..., Any],
    scene_of: Callable[..., Scene],
    *,
    height: int,
    width: int,
    coverage: Coverage | None = None,
    filter: Filter | None = None,
    headroom: float = 2.0,
    has_aux: bool = False,
) -> "ReplanningGradient":
    """Make a function that returns a loss and its gradient, and plans again for a scene that grows.

    The function computes the same as `equinox.filter_value_and_grad(loss)`, compiled. It is for
    loops outside `jit` in which triangles move: when they outgrow the plan, it makes a larger plan
    and repeats the step.

    - `loss(parameters, plan, *args)`: returns a number, computed with `render(scene, plan)`; with
      `has_aux`, a tuple of a number and anything else. The gradient is with respect to all
      floating-point arrays of `parameters`; Python floats are constants.
    - `scene_of(parameters, *args)`: returns the scene that the loss draws, or a batch of scenes. It
      is called outside `jit`, only to plan.
    - `height`, `width`, `coverage`, `filter`, `headroom`: as in `plan`. More headroom costs time in
      each step, and less headroom costs a compilation more often.

    Call the result as `value, gradient = result(parameters, *args)`. `result.plan` is the plan in
    use, and `result.replans` counts how often the plan was replaced. A loss that is NaN or infinite
    although the plan is large enough is returned as it is, after planning once more; for a scene
    with invalid values, such as NaN positions, planning raises `ValueError`. The loss must be NaN
    if the image is: a loss that ignores NaN, such as `jnp.nanmean`, hides that a plan was outgrown.
    """
    gradient = eqx.filter_jit(eqx.filter_value_and_grad(loss, has_aux=has_aux))
    options = {"height": height, "width": width, "coverage": coverage, "filter": filter}
    return ReplanningGradient(gradient, scene_of, options | {"headroom": headroom}, has_aux)


class ReplanningGradient:
    """Function that returns a loss and its gradient, made by `value_and_grad_replanning`.

    - `plan`: the plan in use; None before the first call.
    - `replans`: how often the plan was replaced by a larger one.
    """

    def __init__(
        self,
        gradient: Callable[..., Any],
        scene_of: Callable[..., Scene],
        options: dict[str, Any],
        has_aux: bool,
    ):
        self.plan: Plan | None = None
        self.replans = 0
        self._gradient, self._scene_of = gradient, scene_of
        self._options, self._has_aux = options, has_aux

    def __call__(self, parameters: Any, *args: Any) -> Any:
        """Return the result of the loss, and its gradient with respect to `parameters`.

        With `has_aux`, the result is the tuple that the loss returns. May replace `plan` by a
        larger plan and repeat the step. Raises `ValueError` under a trace, and as `plan` does.
        """
        if is_traced(parameters):
            raise ValueError(
                "`value_and_grad_replanning` plans on the host: call it outside jit, vmap and grad."
            )
        if self.plan is None:
            self.plan = self._plan_for(parameters, *args)
        while True:
            value, gradient = self._gradient(parameters, self.plan, *args)
            if np.isfinite(value[0] if self._has_aux else value):
                return value, gradient
            larger = self._plan_for(parameters, *args)
            if self.plan.holds(larger):
                return value, gradient
            self.plan = larger
            self.replans += 1

    def _plan_for(self, parameters: Any, *args: Any) -> Plan:
        """Plan for the scene of `parameters`; the image is NaN if a scene outgrows the plan."""
        return plan(self._scene_of(parameters, *args), on_overflow="nan", **self._options)
