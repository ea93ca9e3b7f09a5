"""Fit of free triangles: they are added where the error is, and moved where they matter more.

The arrays have one length for the whole fit. Triangles that are not in use yet wait outside the
canvas, beyond the reach of any soft edge, where they cost next to nothing. As the fit goes on:

- until `_GROWTH_END`, triangles are added where the error is largest;
- then, until `_LAST_EXCHANGE`, those whose removal costs least are moved to where they gain more;
- in the last part, nothing changes any more and the learning rate falls.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...color import premultiply
from ...numerics.device import to_device
from ...options import Soft
from ...planning.plan import Plan
from ...planning.size_classes import fine_class
from ...rendering.planner import plan
from ...scene import Scene
from ..closed_form import best_colors
from ..family import AbstractFit, FitRequest
from ..solve import begin, forget_best, move, set_learning_rate
from ..units import POSITION_UNIT
from . import saved
from .placement import place, random_triangles, removal_costs
from .start import background_of, start_of
from .unknowns import LayersData, LayersResidual, LayersUnknowns, layers_scene

_GROWTH_END = 0.4
"""Share of the fit after which all triangles are in use."""

_FIRST_EXCHANGE_PART = 0.3
"""Part of the triangles that the first exchange moves; it falls to zero at the end of the fit."""

_EXCHANGE_INTERVAL, _LAST_EXCHANGE = 0.02, 0.85
"""Share of the fit between two exchanges, and after which there are none."""

_NEW_SIZE, _EXCHANGED_SIZE = 0.9, 0.35
"""Circumradius of new triangles, as a multiple of the side of the square that each triangle has on
average; and by how much smaller those are that an exchange places."""

_GAIN_TO_COME = 10.0
"""Factor from what a new triangle gains at once to what it is expected to gain once it is fitted.
An exchange is made if that is more than the removal costs."""

_LEARNING_RATE = 0.025
"""Half a pixel of position, or 0.025 of colour, per step."""

_RATE_FALL, _LEAST_RATE = 0.3, 0.02
"""Share of the fit, at its end, in which the learning rate falls linearly; and the factor at which
it ends."""

_WAIT_AT, _WAIT_WIDTHS = -16.0, -4.0
"""Both coordinates of triangles that wait: pixels, and widths of the softest edge, from the
canvas."""

_OVERSHOOT = 0.4
"""Canvas sides by which a corner may leave the canvas, or more if the scene to start from does.
Hard mode clips what is more than half a side outside."""

_SHARPENED = 0.5
"""Share of the fit after which soft edges have their last width."""


class _Earlier(NamedTuple):
    """The best unknowns before triangles were moved elsewhere, and their loss."""

    loss: float
    y: LayersUnknowns


class LayersFit(AbstractFit):
    """A fit of free triangles, flat or with corner colours, opaque or translucent.

    - `length`: number of triangles in the arrays, a size class, so that fits of nearby numbers of
      triangles share programs. A resumed fit has the length that was saved.
    """

    data: LayersData

    def __init__(self, request: FitRequest):
        self.request = request
        image, settings = request.target.image, request.settings
        self.height, self.width = image.shape[:2]
        self._gouraud = settings["shading"] == "gouraud"
        self._translucent: bool = settings["translucent"]
        self._softness: tuple[float, float] = settings["softness"]
        state = request.resume_state
        self.length = fine_class(self.max_triangles)
        if state is not None:
            self.length = saved.length_of(state)
        # A resumed fit gets its triangles from its state; any start of the right shapes will do.
        start = request.start if state is None else "uniform"
        self._rng = np.random.default_rng(request.seed)
        self._background = background_of(start, request.target)
        weights = request.target.weights
        self.data = LayersData(
            request.loss.prepare(to_device(image)),
            None if weights is None else to_device(weights, np.float32),
            to_device(self._background),
            to_device(self._softness[0], np.float32),
        )
        y, self.active = self._start(start)
        self._overshoot = _OVERSHOOT
        if isinstance(start, Scene):
            self._overshoot = max(_OVERSHOOT, self._overshoot_of(y))
        self.residual = LayersResidual(self._plan([self.likely_scene()]), request.loss)
        self.progress = begin(request.solver, self.residual, y, self.data)
        self._earlier: _Earlier | None = None
        self.image = np.broadcast_to(self._background, image.shape)
        self.last_exchange = 0.0

    @property
    def max_triangles(self) -> int:
        """The option `triangles`."""
        return self.request.settings["triangles"]

    @property
    def _wait_at(self) -> float:
        """Both coordinates of triangles that wait, in pixels."""
        return _WAIT_AT + _WAIT_WIDTHS * max(self._softness)

    def _start(self, start: str | Scene) -> tuple[LayersUnknowns, int]:
        """The unknowns, and how many triangles are in use."""
        count = self.max_triangles
        first = start_of(
            start, self.request.target, self._rng, triangles=count,
            gouraud=self._gouraud, translucent=self._translucent,
            circumradius=_NEW_SIZE * self._spacing(count),
        )  # fmt: skip
        active, length = len(first.corners), self.length
        corners = np.full((length, 3, 2), self._wait_at, np.float32)
        colors = np.full((length, 3 if self._gouraud else 1, 3), 0.5, np.float32)
        opacity = np.ones(length, np.float32)
        corners[:active], colors[:active], opacity[:active] = first
        return self._unknowns(corners, colors, opacity), active

    def _unknowns(
        self, corners: np.ndarray, colors: np.ndarray, opacity: np.ndarray
    ) -> LayersUnknowns:
        """Unknowns on the device, from corners in pixels."""
        return LayersUnknowns(
            to_device(corners / POSITION_UNIT, np.float32),
            to_device(colors),
            to_device(opacity) if self._translucent else None,
        )

    def _spacing(self, count: int) -> float:
        """Side of the square, in pixels, that each of `count` triangles has on average."""
        return float(np.sqrt(self.height * self.width / max(count, 1)))

    def likely_scene(self) -> Scene:
        """Random triangles, as many as there may be, somewhat larger than new ones."""
        count = self.max_triangles
        rng = np.random.default_rng(0)
        middle = rng.random((count, 2)) * [self.width, self.height]
        corners = np.full((self.length, 3, 2), self._wait_at)
        corners[:count] = random_triangles(rng, middle, 1.6 * self._spacing(count))
        colors = np.zeros((self.length, 3 if self._gouraud else 1, 3), np.float32)
        opacity = np.full(self.length, 0.5, np.float32)
        y = self._unknowns(corners, colors, opacity)
        return layers_scene(y, self.data.background)

    def _plan(self, scenes: list[Scene]) -> Plan:
        return plan(
            scenes,
            height=self.height,
            width=self.width,
            coverage=Soft(self._softness[1]),
            max_width=max(self._softness),
        )

    @property
    def _best(self) -> LayersUnknowns:
        """The best unknowns so far."""
        loss = float(self.progress.best_loss)
        if self._earlier is not None and not self._earlier.loss > loss:
            return self._earlier.y
        return self.progress.best if np.isfinite(loss) else self.progress.y

    def scene(self, *, padded: bool = False) -> Scene:
        """The best scene so far; `padded` by the triangles that wait outside."""
        drawn = slice(None if padded else self.active)
        y = jax.tree.map(lambda leaf: leaf[drawn], self._best)
        return layers_scene(self._near_canvas(y), self.data.background)

    def polish(self) -> None:
        """Go to the best unknowns so far, with the colours of least squared error."""
        y, loss = self._best, self.request.loss
        # The best unknowns may be older than the last exchange, and not fit the plan of now.
        needed = self._plan([self.likely_scene(), layers_scene(y, self.data.background)])
        if not self.residual.plan.holds(needed):
            self.residual = LayersResidual(needed, loss)
        y = best_colors(self.residual, y, self.data, loss.light)
        self._earlier = None
        moved = move(self.request.solver, self.residual, self.progress, y, self.data)
        self.progress = forget_best(moved)

    def replan(self, reached: list[LayersUnknowns]) -> LayersResidual:
        """A residual with capacity for these unknowns and for the likely scene."""
        scenes = [layers_scene(y, self.data.background) for y in reached]
        return LayersResidual(self._plan([self.likely_scene(), *scenes]), self.request.loss)

    def refine(self, share: float) -> None:
        """Sharpen edges, lower the learning rate, and add or exchange triangles."""
        total = self.max_triangles
        self._sharpen(share)
        if self.request.adjustable_rate:
            factor = max(_LEAST_RATE, min(1.0, (1 - share) / _RATE_FALL))
            self.progress = set_learning_rate(self.progress, _LEARNING_RATE * factor)
            y = self.progress.y
            waits = jnp.arange(self.length)[:, None, None] >= self.active
            corners = jnp.where(waits, y.corners, self._near_canvas(y).corners)
            self.progress = self.progress._replace(y=y._replace(corners=corners))
        if not self.request.exchanges:
            return
        wanted = int(min(total, max(8, total * min(1.0, share / _GROWTH_END) ** 1.5)))
        missing = max(0, wanted - self.active)
        # Few large additions are better than many small ones: each restarts solvers of 2nd order.
        if missing >= max(1, self.active // 20) or (missing and wanted == total):
            self._add(missing)
        elif (
            self.active == total
            and share < _LAST_EXCHANGE
            and share - self.last_exchange >= _EXCHANGE_INTERVAL
        ):
            self.last_exchange = share
            self._exchange(max(1, int(total * _FIRST_EXCHANGE_PART * (1 - share))))

    def _sharpen(self, share: float) -> None:
        """Set the width of soft edges for this share of the fit.

        Losses at different widths do not compare, so a new width forgets the best so far.
        """
        first, last = self._softness
        width = np.float32(first * (last / first) ** min(1.0, share / _SHARPENED))
        if width != np.float32(self.data.width):
            self.data = self.data._replace(width=to_device(width))
            self._earlier, self.progress = None, forget_best(self.progress)

    def _overshoot_of(self, y: LayersUnknowns) -> float:
        """By how many canvas sides the triangles in use leave the canvas."""
        side = max(self.height, self.width)
        outside = np.abs(np.asarray(y.corners[: self.active]) * POSITION_UNIT / side - 0.5) - 0.5
        return float(outside.max(initial=0.0))

    def _near_canvas(self, y: LayersUnknowns) -> LayersUnknowns:
        """The unknowns with their corners clipped to the neighbourhood of the canvas."""
        side = max(self.height, self.width)
        low = -self._overshoot * side / POSITION_UNIT
        high = (1 + self._overshoot) * side / POSITION_UNIT
        return y._replace(corners=jnp.clip(y.corners, low, high))

    def _add(self, count: int) -> None:
        """Put up to `count` waiting triangles in front, where they lower the error most."""
        target = self.request.target
        new = place(
            self._rng, premultiply(self.image), premultiply(target.image), count,
            size=_NEW_SIZE * self._spacing(self.active + count), weights=target.weights,
        )  # fmt: skip
        number = len(new.corners)
        if number == 0:
            return
        self._replace_triangles(np.arange(self.length), self.active, new.corners, new.colors)
        self.active += number

    def _exchange(self, count: int) -> None:
        """Move up to `count` triangles whose removal costs least to where they gain more, in front.

        Only those move whose expected gain is more than the cost of their removal.
        """
        total, target = self.max_triangles, self.request.target
        goal = premultiply(target.image)
        y = jax.tree.map(lambda leaf: np.asarray(leaf)[:total], self.progress.y)
        opacity = None if y.opacity is None else np.clip(y.opacity, 0, 1)
        costs = removal_costs(
            y.corners * POSITION_UNIT, np.clip(y.colors, 0, 1), opacity, goal,
            self._background, target.weights,
        )  # fmt: skip
        new = place(
            self._rng, premultiply(self.image), goal, count,
            size=_NEW_SIZE * _EXCHANGED_SIZE * self._spacing(total), weights=target.weights,
        )  # fmt: skip
        best = np.argsort(-new.gains)
        least = np.argsort(costs)[: len(best)]
        useful = int(np.sum(_GAIN_TO_COME * new.gains[best] > costs[least]))
        if useful == 0:
            return
        removed, best = least[:useful], best[:useful]
        staying, spare = np.setdiff1d(np.arange(total), removed), np.arange(total, self.length)
        order = np.concatenate([staying, removed, spare])
        self._replace_triangles(order, total - useful, new.corners[best], new.colors[best])

    def _replace_triangles(
        self, order: np.ndarray, first: int, corners: np.ndarray, colors: np.ndarray
    ) -> None:
        """Put the triangles into `order`, then replace those from `first` on by new ones.

        `corners`: `[new, 3, 2]` in pixels; `colors`: `[new, 3]`. The loss rises for a while after
        this, so the best so far is kept aside.
        """
        stop, total = first + len(corners), len(order)
        if np.isfinite(self.progress.best_loss):
            earlier = np.inf if self._earlier is None else self._earlier.loss
            self._earlier = _Earlier(min(float(self.progress.best_loss), earlier), self._best)

        def reordered(values: Any, new: Any) -> Any:
            host = np.asarray(values)[order]
            host[first:stop] = new
            return to_device(host)

        def reordered_memory(leaf: Any) -> Any:
            per_triangle = isinstance(leaf, jax.Array) and leaf.ndim and leaf.shape[0] == total
            return reordered(leaf, 0) if per_triangle else leaf

        y = self.progress.y
        opacity = None if y.opacity is None else reordered(y.opacity, 0.9)
        y = LayersUnknowns(
            reordered(y.corners, corners / POSITION_UNIT),
            reordered(y.colors, colors[:, None]),
            opacity,
        )
        if self.request.adjustable_rate:
            # Adam's memory has one number per unknown: it follows, and starts at 0 for new ones.
            solver_state = jax.tree.map(reordered_memory, self.progress.state)
            self.progress = forget_best(self.progress._replace(y=y, state=solver_state))
        else:
            fresh = begin(self.request.solver, self.residual, y, self.data)
            self.progress = fresh._replace(steps=self.progress.steps)

    def own_state(self) -> dict[str, np.ndarray]:
        """Random generator, background, edge width, and the best before the last exchange."""
        best = None if self._earlier is None else (self._earlier.loss, self._earlier.y)
        return saved.pack(best, self._overshoot, self.data.width, self._background, self._rng)

    def restore_own_state(self, arrays: dict[str, np.ndarray]) -> None:
        """Undo `own_state`."""
        self._background, self._overshoot = arrays["background"], float(arrays["beyond"])
        self.data = self.data._replace(
            background=to_device(self._background), width=to_device(arrays["width"])
        )
        saved.restore_generator(self._rng, arrays)
        best = saved.unpack_best(self.progress.y, arrays)
        if best is not None:
            self._earlier = _Earlier(*best)
