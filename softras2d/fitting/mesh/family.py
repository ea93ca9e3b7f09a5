"""A fit of a mesh between chunks of steps: no triangle flipped, vertices put to use again."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...numerics.device import to_device
from ...options import Area
from ...planning.plan import Plan
from ...rendering.planner import plan
from ...scene import Scene
from ..chunk import take_steps
from ..closed_form import best_colors
from ..layers.unknowns import UNIT
from ..loss import Loss
from ..solve import begin, forget_best, move, set_rate
from ..solvers import Solver
from .start import delaunay_start, error_start, exchange, uniform_start
from .triangulation import Mesh, check_tiling, signed_areas
from .unknowns import Tiling, TilingData, TilingResidual, tiling_scene, vertices_of
from .untangle import untangle
from .vertex_colors import Colors, Image, PixelMap, solve_colors

_RATE = 0.03
"""Of steps that have one: two thirds of a pixel, and as much of colour. It falls as a cosine."""

_LEAST_RATE = 0.02
"""Of it, at the end."""

_THIN, _LEAST_SCALE = 0.3, 0.02
"""Units of position per pixel of altitude, up to one; and the least."""

_EXCHANGES = (
    (0.1, 0.15), (0.2, 0.12), (0.3, 0.1), (0.4, 0.08), (0.5, 0.06), (0.6, 0.05), (0.7, 0.04),
)  # fmt: skip
"""How far the fit is, and which share of the vertices is then put to use elsewhere."""


@dataclass(frozen=True)
class TilingChoice:
    """How the mesh is to be.

    - `vertices`: how many; `colors`: the model; `solve`: whether they are solved for between
      chunks.
    - `start`: `"error"`, `"uniform"`, `"delaunay"`, or a mesh; `exchange`: whether vertices are put
      to use elsewhere.
    - `tuned`: whether the solver is our own `"adam"`.
    """

    vertices: int
    colors: Colors
    solve: bool
    start: str | Mesh
    exchange: bool
    tuned: bool


class Kept(NamedTuple):
    """The best there was before vertices were put to use elsewhere."""

    least: float
    y: Tiling
    mesh: Mesh
    data: TilingData


class TilingFit:
    """The state of a fit: what `advance` and `refine` change."""

    def __init__(
        self,
        target: Image,
        weights: PixelMap | None,
        choice: TilingChoice,
        loss: Loss,
        solver: Solver,
        seed: int,
        hurry: Callable[[], bool] = lambda: False,
    ):
        if target.shape[-1] == 4:
            raise ValueError("a mesh covers the canvas: fit targets with alpha by layers.")
        self.choice, self.loss, self.solver = choice, loss, solver
        self.target, self.weights = target, weights
        self.height, self.width = target.shape[:2]
        self.image = target
        self.exchanged = 0.0
        self.kept: Kept | None = None
        mesh = self._start(seed, hurry)
        data, y = self.prepare(mesh)
        self.residual = TilingResidual(self._plan([tiling_scene(y, data)]), loss)
        self._begin(mesh, data, y)

    @property
    def most(self) -> int:
        """Triangles that there may be."""
        return self.active

    def _start(self, seed: int, hurry: Callable[[], bool]) -> Mesh:
        choice = self.choice
        if isinstance(choice.start, Mesh):
            return self._checked(choice.start)
        if choice.start == "uniform":
            return uniform_start(self.height, self.width, choice.vertices, seed=seed)
        if choice.start == "delaunay":
            return delaunay_start(self.target, choice.vertices, weights=self.weights, seed=seed)
        if choice.start != "error":
            raise ValueError(
                "`start` must be 'error', 'uniform', 'delaunay' or a Mesh; got "
                f"{choice.start!r:.60}."
            )
        return error_start(
            self.target, choice.vertices, colors=choice.colors, weights=self.weights, seed=seed,
            hurry=hurry,
        )  # fmt: skip

    def _checked(self, mesh: Mesh) -> Mesh:
        if (mesh.height, mesh.width) != (self.height, self.width):
            raise ValueError(
                f"`start` is a mesh of {mesh.width} x {mesh.height} pixels; the fit has "
                f"{self.width} x {self.height}."
            )
        if len(mesh.positions) > self.choice.vertices:
            raise ValueError(
                f"`start` has {len(mesh.positions)} vertices; `triangles` allows "
                f"{self.choice.vertices}."
            )
        check_tiling(mesh)
        return mesh

    def prepare(self, mesh: Mesh, scale: np.ndarray | None = None) -> tuple[TilingData, Tiling]:
        """Arguments and unknowns of a mesh, with the colours of least squared error.

        `scale`: that of `TilingData`, if the mesh is not to tell it.
        """
        # As many as a mesh of so many vertices can have: with four on the border.
        room, active = 2 * len(mesh.positions) - 6, len(mesh.triangles)
        triangles = np.zeros((room, 3), np.int32)
        triangles[:active] = mesh.triangles
        if scale is None:
            scale = UNIT * np.clip(_THIN * _altitudes(mesh)[:, None], _LEAST_SCALE, 1.0)
        data = TilingData(
            self.loss.prepare(to_device(self.target, np.float32)),
            None if self.weights is None else to_device(self.weights, np.float32),
            to_device(np.zeros(3, np.float32)),
            to_device(triangles),
            to_device(np.stack([mesh.free_x, mesh.free_y], 1)),
            to_device(mesh.positions, np.float32),
            to_device(scale, np.float32),
        )
        found = solve_colors(mesh, self.target, colors=self.choice.colors, weights=self.weights)
        found = np.clip(found, 0, 1)
        if self.choice.colors != "vertex":
            found = found[:, None] if found.ndim == 2 else found
            found = np.concatenate([found, np.zeros((room - active, *found.shape[1:]))])
        positions = to_device(mesh.positions / scale, np.float32)
        return data, Tiling(positions, to_device(found, np.float32))

    def _begin(self, mesh: Mesh, data: TilingData, y: Tiling) -> None:
        self.progress = begin(self.solver, self.residual, y, data)
        self.mesh, self.data, self.active = mesh, data, len(mesh.triangles)

    def likely(self) -> Scene:
        """A scene like those that the fit will go through, to plan for."""
        return tiling_scene(self.progress.y, self.data)

    def _plan(self, scenes: list[Scene]) -> Plan:
        return plan(scenes, height=self.height, width=self.width, coverage=Area("sum"))

    def best(self) -> Kept:
        """The best so far, its mesh untangled."""
        least = float(self.progress.least)
        if self.kept is not None and not self.kept.least > least:
            return self.kept
        y = self.progress.best if np.isfinite(least) else self.progress.y
        mesh, y = _mended(y, self.mesh, self.data)
        return Kept(least, y, mesh, self.data)

    def scene(self, *, padded: bool = False) -> Scene:
        """The best scene so far, in pixels of the fit; `padded` by triangles without area."""
        best = self.best()
        scene = tiling_scene(best.y, best.data)
        drawn = slice(None if padded else len(best.mesh.triangles))
        triangles, colors = (
            to_device(np.asarray(whole)[drawn]) for whole in (scene.triangles, scene.colors)
        )
        return replace(scene, triangles=triangles, colors=colors)

    def polish(self) -> None:
        """The best unknowns so far, with the colours of least squared error."""
        _, y, self.mesh, self.data = self.best()
        self.active, self.kept = len(self.mesh.triangles), None
        # Of before an exchange it may not fit the plan of now.
        room = self._plan([tiling_scene(y, self.data)])
        if not self.residual.plan.holds(room):
            self.residual = TilingResidual(room, self.loss)
        y = best_colors(self.residual, y, self.data, self.loss.light)
        self.progress = forget_best(move(self.solver, self.residual, self.progress, y, self.data))

    @property
    def solves(self) -> bool:
        """Whether colours are solved for between chunks."""
        return self.choice.solve

    def replan(self, led: list[Tiling]) -> TilingResidual:
        """A residual with room for where the unknowns led."""
        return TilingResidual(self._plan([tiling_scene(y, self.data) for y in led]), self.loss)

    def advance(self, steps: int, room: int) -> np.ndarray:
        """Losses of so many steps, or of fewer."""
        return take_steps(self, steps, room)

    def refine(self, share: float) -> None:
        """What the host does between chunks, `share` of the way through the fit."""
        due = [part for at, part in _EXCHANGES if self.exchanged < at <= share]
        if self.progress.steps:
            self._untangle()
        if due and self.choice.exchange:
            self.exchanged = share
            self._exchange(max(1, int(due[-1] * len(self.mesh.positions))))
        if self.choice.tuned:
            rate = _RATE * max(_LEAST_RATE, 0.5 + 0.5 * np.cos(np.pi * share))
            self.progress = set_rate(self.progress, float(rate))

    def _untangle(self) -> None:
        """Other solvers keep what they know of a point, and go on from it."""
        self.mesh, y = _mended(self.progress.y, self.mesh, self.data)
        if self.choice.tuned:
            self.progress = self.progress._replace(y=y)

    def _exchange(self, count: int) -> None:
        """The vertices that matter least go where they matter more."""
        steps = self.progress.steps
        vertices = len(self.mesh.positions)
        mesh = exchange(
            self.mesh, self.target, count, colors=self.choice.colors, weights=self.weights
        )
        if len(mesh.positions) == vertices:
            if np.isfinite(self.progress.least):
                self.kept = self.best()
            self._begin(mesh, *self.prepare(mesh))
            self.progress = self.progress._replace(steps=steps)


def _mended(y: Tiling, mesh: Mesh, data: TilingData) -> tuple[Mesh, Tiling]:
    """The mesh where the unknowns are, without triangles turned over."""
    mesh = untangle(mesh, np.asarray(vertices_of(y, data), np.float64))
    positions = mesh.positions.astype(np.float32) / np.asarray(data.scale)
    return mesh, y._replace(positions=to_device(positions))


def _altitudes(mesh: Mesh) -> Float[np.ndarray, " vertices"]:
    """Of each vertex, the least altitude of its triangles, in pixels."""
    corners = mesh.positions[mesh.triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, 1), axis=-1).max(1)
    least = np.full(len(mesh.positions), np.inf)
    altitude = 2 * signed_areas(mesh.positions, mesh.triangles) / longest
    np.minimum.at(least, mesh.triangles.ravel(), np.repeat(altitude, 3))
    return least
