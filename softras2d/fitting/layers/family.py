"""A fit of layers between chunks of steps: triangles placed, put to use again, plans renewed."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...numerics.device import to_device
from ...options import Soft
from ...planning.plan import Plan
from ...planning.size_classes import fine_class
from ...rendering.planner import plan
from ...scene import Scene
from ..chunk import take_steps
from ..closed_form import best_colors
from ..loss import Loss
from ..mesh.vertex_colors import Image, PixelMap
from ..solve import begin, forget_best, move, set_rate
from ..solvers import Solver
from .placement import place, random_triangles, removal_costs
from .start import background_of, start_of
from .unknowns import UNIT, Layers, LayersData, LayersResidual, layers_scene

_GROWTH = 0.4
"""Share of the fit after which all triangles are there."""

_EXCHANGE = 0.3
"""Share of the triangles that the first exchange puts to use again; it falls to zero at the end."""

_PAUSE, _LAST = 0.02, 0.85
"""Share of the fit between two exchanges, and after which there is none."""

_SIZE, _FINER = 0.9, 0.35
"""Circumradius of a new triangle, in sides of the square that each has on average; and how much
smaller those are that replace others."""

_HOPE = 10.0
"""How many times what a new triangle gains at once is what it will have gained at the end."""

_RATE = 0.025
"""Of steps that have one: half a pixel, and half that of colour at its start. It falls at the end
in a straight line."""

_FALL, _LEAST = 0.3, 0.02

_ASIDE, _PER_WIDTH = -16.0, -4.0
"""Where triangles wait that are not drawn yet: pixels, and widths of the softest edge."""

_BEYOND = 0.4
"""Canvas sides that a corner may go beyond the canvas, or as many as a scene to start from does:
hard mode clips what is half a side out."""

_ANNEALED = 0.5
"""Share of the fit after which soft edges have their last width."""


@dataclass(frozen=True)
class LayersChoice:
    """How the triangles are to be.

    - `triangles`: how many; `gouraud`: whether they have corner colours; `translucent`: whether
      opacity is an unknown; `softness`: the first and last width of soft edges in pixels.
    - `solve`: whether colours are solved for between chunks.
    - `start`: `"error"`, `"uniform"`, `"delaunay"`, or a scene in pixels of the fit; `exchange`:
      whether triangles are placed where the error is, and anew.
    - `tuned`: whether the solver is our own `"adam"`, whose rate and memory, one number for each
      unknown, this fit knows.
    """

    triangles: int
    gouraud: bool
    translucent: bool
    softness: tuple[float, float]
    solve: bool
    start: str | Scene
    exchange: bool
    tuned: bool


class Kept(NamedTuple):
    """The best there was before triangles were put to use elsewhere."""

    least: float
    y: Layers


class LayersFit:
    """The state of a fit: what `advance` and `refine` change."""

    def __init__(
        self,
        target: Image,
        weights: PixelMap | None,
        choice: LayersChoice,
        loss: Loss,
        solver: Solver,
        seed: int,
        length: int | None = None,
    ):
        """`length`: triangles of the arrays, of a saved fit; by default a size class, so that fits
        of like size share programs. What is beyond `most` waits outside for good."""
        self.choice, self.loss, self.solver = choice, loss, solver
        self.length = fine_class(choice.triangles) if length is None else length
        self.target, self.weights = target, weights
        self.height, self.width = target.shape[:2]
        self.rng = np.random.default_rng(seed)
        self.background = background_of(choice.start, target, weights)
        self.data = LayersData(
            loss.prepare(to_device(target)),
            None if weights is None else to_device(weights, np.float32),
            to_device(self.background),
            to_device(choice.softness[0], np.float32),
        )
        y, self.active = self._start()
        self.beyond = _BEYOND
        if isinstance(choice.start, Scene):
            self.beyond = max(_BEYOND, self._reach(y))
        self.residual = LayersResidual(self._plan([self.likely()]), loss)
        self.progress = begin(solver, self.residual, y, self.data)
        self.kept: Kept | None = None
        self.image = np.broadcast_to(self.background, target.shape)
        self.exchanged = 0.0

    @property
    def most(self) -> int:
        """Triangles that there may be."""
        return self.choice.triangles

    @property
    def _aside(self) -> float:
        """Both coordinates of triangles that wait, in pixels."""
        return _ASIDE + _PER_WIDTH * max(self.choice.softness)

    def _start(self) -> tuple[Layers, int]:
        """The unknowns, and how many triangles are in use."""
        choice = self.choice
        count, corners = choice.triangles, 3 if choice.gouraud else 1
        found = start_of(
            choice.start, self.target, self.weights, self.rng, triangles=count,
            gouraud=choice.gouraud, translucent=choice.translucent,
            circumradius=_SIZE * self._spacing(count),
        )  # fmt: skip
        active, length = len(found.corners), self.length
        places = np.full((length, 3, 2), self._aside, np.float32)
        colors = np.full((length, corners, 3), 0.5, np.float32)
        opacity = np.ones(length, np.float32)
        places[:active], colors[:active], opacity[:active] = found
        held = to_device(opacity) if choice.translucent else None
        return Layers(to_device(places / UNIT, np.float32), to_device(colors), held), active

    def _spacing(self, count: int) -> float:
        """Side of the square that each of so many triangles has, in pixels."""
        return float(np.sqrt(self.height * self.width / max(count, 1)))

    def likely(self) -> Scene:
        """A scene like those that the fit will go through, to plan for."""
        count = self.choice.triangles
        rng = np.random.default_rng(0)
        middle = rng.random((count, 2)) * [self.width, self.height]
        corners = np.full((self.length, 3, 2), self._aside)
        corners[:count] = random_triangles(rng, middle, 1.6 * self._spacing(count))
        colors = np.zeros((self.length, 3 if self.choice.gouraud else 1, 3), np.float32)
        opacity = np.full(self.length, 0.5, np.float32) if self.choice.translucent else None
        held = None if opacity is None else to_device(opacity)
        y = Layers(to_device(corners / UNIT, np.float32), to_device(colors), held)
        return layers_scene(y, self.data.background)

    def _plan(self, scenes: list[Scene]) -> Plan:
        return plan(
            scenes,
            height=self.height,
            width=self.width,
            coverage=Soft(self.choice.softness[1]),
            max_width=max(self.choice.softness),
        )

    @property
    def y(self) -> Layers:
        """The best unknowns so far."""
        least = float(self.progress.least)
        if self.kept is not None and not self.kept.least > least:
            return self.kept.y
        return self.progress.best if np.isfinite(least) else self.progress.y

    def scene(self, *, padded: bool = False) -> Scene:
        """The best scene so far, in pixels of the fit; `padded` by triangles that wait outside."""
        drawn = slice(None if padded else self.active)
        y = jax.tree.map(lambda leaf: leaf[drawn], self.y)
        return layers_scene(self._near(y), self.data.background)

    def polish(self) -> None:
        """The best unknowns so far, with the colours of least squared error."""
        y = self.y
        # Of before an exchange it may not fit the plan of now.
        room = self._plan([self.likely(), layers_scene(y, self.data.background)])
        if not self.residual.plan.holds(room):
            self.residual = LayersResidual(room, self.loss)
        y = best_colors(self.residual, y, self.data, self.loss.light)
        self.kept = None
        self.progress = forget_best(move(self.solver, self.residual, self.progress, y, self.data))

    @property
    def solves(self) -> bool:
        """Whether colours are solved for between chunks."""
        return self.choice.solve

    def replan(self, led: list[Layers]) -> LayersResidual:
        """A residual with room for where the unknowns led."""
        seen = [layers_scene(y, self.data.background) for y in led]
        return LayersResidual(self._plan([self.likely(), *seen]), self.loss)

    def advance(self, steps: int, room: int) -> np.ndarray:
        """Losses of so many steps, or of fewer."""
        return take_steps(self, steps, room)

    def refine(self, share: float) -> None:
        """What the host does between chunks, `share` of the way through the fit."""
        total = self.choice.triangles
        self._sharpen(share)
        if self.choice.tuned:
            rate = _RATE * max(_LEAST, min(1.0, (1 - share) / _FALL))
            self.progress = set_rate(self.progress, rate)
            y = self.progress.y
            waits = jnp.arange(self.length)[:, None, None] >= self.active
            corners = jnp.where(waits, y.corners, self._near(y).corners)
            self.progress = self.progress._replace(y=y._replace(corners=corners))
        if not self.choice.exchange:
            return
        wanted = int(min(total, max(8, total * min(1.0, share / _GROWTH) ** 1.5)))
        missing = max(0, wanted - self.active)
        if missing >= max(1, self.active // 20) or (missing and wanted == total):
            self._place(missing, _SIZE)
        elif self.active == total and share < _LAST and share - self.exchanged >= _PAUSE:
            self.exchanged = share
            self._exchange(max(1, int(total * _EXCHANGE * (1 - share))))

    def _sharpen(self, share: float) -> None:
        """Soft edges as wide as they are to be by now; losses at other widths do not compare."""
        first, last = self.choice.softness
        width = np.float32(first * (last / first) ** min(1.0, share / _ANNEALED))
        if width != np.float32(self.data.width):
            self.data = self.data._replace(width=to_device(width))
            self.kept, self.progress = None, forget_best(self.progress)

    def _reach(self, y: Layers) -> float:
        """Canvas sides that triangles in use go beyond the canvas."""
        side = max(self.height, self.width)
        far = np.abs(np.asarray(y.corners[: self.active]) * UNIT / side - 0.5) - 0.5
        return float(far.max(initial=0.0))

    def _near(self, y: Layers) -> Layers:
        """With corners held near the canvas."""
        side = max(self.height, self.width)
        low, high = -self.beyond * side / UNIT, (1 + self.beyond) * side / UNIT
        return y._replace(corners=jnp.clip(y.corners, low, high))

    def _place(self, count: int, size: float) -> None:
        found = place(
            self.rng, premultiplied(self.image), premultiplied(self.target), count,
            size=size * self._spacing(self.active + count), weights=self.weights,
        )  # fmt: skip
        number = len(found.corners)
        if number == 0:
            return
        order = np.arange(self.length)
        self._change(order, self.active, found.corners, found.colors)
        self.active += number

    def _exchange(self, count: int) -> None:
        """The triangles that matter least are drawn last instead, where they matter more."""
        total = self.choice.triangles
        y = jax.tree.map(lambda leaf: np.asarray(leaf)[:total], self.progress.y)
        opacity = None if y.opacity is None else np.clip(y.opacity, 0, 1)
        costs = removal_costs(
            y.corners * UNIT, np.clip(y.colors, 0, 1), opacity, premultiplied(self.target),
            self.background, self.weights,
        )  # fmt: skip
        found = place(
            self.rng, premultiplied(self.image), premultiplied(self.target), count,
            size=_SIZE * _FINER * self._spacing(self.choice.triangles), weights=self.weights,
        )  # fmt: skip
        best = np.argsort(-found.gains)
        least = np.argsort(costs)[: len(best)]
        useful = int(np.sum(_HOPE * found.gains[best] > costs[least]))
        if useful == 0:
            return
        dropped, best = least[:useful], best[:useful]
        stay, spare = np.setdiff1d(np.arange(total), dropped), np.arange(total, self.length)
        order = np.concatenate([stay, dropped, spare])
        first = total - useful
        self._change(order, first, found.corners[best], found.colors[best])

    def _change(self, order: np.ndarray, first: int, corners: Any, colors: Any) -> None:
        """Triangles in another order, and from `first` on new ones."""
        stop, total = first + len(corners), len(order)
        if np.isfinite(self.progress.least):
            self.kept = Kept(min(float(self.progress.least), _least(self.kept)), self.y)

        def put(values: Any, new: Any) -> Any:
            host = np.asarray(values)[order]
            host[first:stop] = new
            return to_device(host)

        def forget(leaf: Any) -> Any:
            follows = isinstance(leaf, jax.Array) and leaf.ndim and leaf.shape[0] == total
            return put(leaf, 0) if follows else leaf

        y = self.progress.y
        opacity = None if y.opacity is None else put(y.opacity, 0.9)
        y = Layers(put(y.corners, corners / UNIT), put(y.colors, colors[:, None]), opacity)
        if self.choice.tuned:
            state = jax.tree.map(forget, self.progress.state)
            self.progress = forget_best(self.progress._replace(y=y, state=state))
        else:
            fresh = begin(self.solver, self.residual, y, self.data)
            self.progress = fresh._replace(steps=self.progress.steps)


def premultiplied(image: Image) -> Image:
    """Colours times alpha, and alpha; an image without alpha as it is."""
    if image.shape[-1] == 3:
        return image
    alpha = image[..., 3:]
    return np.concatenate([image[..., :3] * alpha, alpha], -1)


def _least(kept: Kept | None) -> float:
    return np.inf if kept is None else kept.least
