"""A fit of a mesh between chunks of steps: no triangle flipped, vertices put to use again."""

from dataclasses import dataclass, replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..options import Area
from ..plan import Plan, plan
from ..scene import Scene
from .closed_form import best_colors
from .layers import UNIT
from .loss import Loss
from .mesh_colors import Colors, Image, PixelMap, solve_colors
from .mesh_start import error_start, exchange, uniform_start
from .solve import advance, begin, forget_best, set_rate
from .solvers import Solver, is_first_order
from .tiling import Tiling, TilingData, TilingResidual, tiling_scene, vertices_of
from .triangulation import Mesh, signed_areas
from .untangle import untangle

_RATE = 0.015
"""Of steps that have one: a third of a pixel, and as much of colour. It falls as a cosine."""

_LEAST_RATE = 0.02
"""Of it, at the end."""

_THIN, _LEAST_SCALE = 0.3, 0.02
"""Units of position per pixel of altitude, up to one; and the least."""

_EXCHANGES = ((0.2, 0.1), (0.35, 0.07), (0.5, 0.05))
"""How far the fit is, and which share of the vertices is then put to use elsewhere."""


@dataclass(frozen=True)
class TilingChoice:
    """How the mesh is to be: the number of vertices, the model of its colours, whether they are
    solved for between chunks, where it starts: `"error"`, `"uniform"`, or a mesh; `exchange`:
    whether vertices are put to use elsewhere.
    """

    vertices: int
    colors: Colors
    solve: bool
    start: str | Mesh
    exchange: bool


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
    ):
        if target.shape[-1] == 4:
            raise ValueError("a mesh covers the canvas: fit targets with alpha by layers.")
        self.choice, self.loss, self.solver = choice, loss, solver
        self.target, self.weights = target, weights
        self.height, self.width = target.shape[:2]
        self.image = target
        self.exchanged = 0.0
        self._adopt(self._start(seed))

    def _start(self, seed: int) -> Mesh:
        choice = self.choice
        if isinstance(choice.start, Mesh):
            return choice.start
        if choice.start == "uniform":
            return uniform_start(self.height, self.width, choice.vertices, seed=seed)
        if choice.start != "error":
            raise ValueError(
                f"`start` must be 'error', 'uniform' or a Mesh; got {choice.start!r:.60}."
            )
        return error_start(
            self.target, choice.vertices, colors=choice.colors, weights=self.weights, seed=seed
        )

    def _adopt(self, mesh: Mesh) -> None:
        """A solve that begins with this mesh, and the colours of least squared error."""
        self.mesh, self.active = mesh, len(mesh.triangles)
        # As many as a mesh of so many vertices can have: with four on the border.
        room = 2 * len(mesh.positions) - 6
        triangles = np.zeros((room, 3), np.int32)
        triangles[: self.active] = mesh.triangles
        scale = UNIT * np.clip(_THIN * _altitudes(mesh)[:, None], _LEAST_SCALE, 1.0)
        self.data = TilingData(
            self.loss.prepare(jnp.asarray(self.target, jnp.float32)),
            None if self.weights is None else jnp.asarray(self.weights, jnp.float32),
            jnp.zeros(3, jnp.float32),
            jnp.asarray(triangles),
            jnp.asarray(np.stack([mesh.free_x, mesh.free_y], 1)),
            jnp.asarray(mesh.positions, jnp.float32),
            jnp.asarray(scale, jnp.float32),
        )
        found = solve_colors(mesh, self.target, colors=self.choice.colors, weights=self.weights)
        found = np.clip(found, 0, 1)
        if self.choice.colors != "vertex":
            found = found[:, None] if found.ndim == 2 else found
            found = np.concatenate([found, np.zeros((room - self.active, *found.shape[1:]))])
        positions = jnp.asarray(mesh.positions / scale, jnp.float32)
        y = Tiling(positions, jnp.asarray(found, jnp.float32))
        scene = tiling_scene(y, self.data)
        if not hasattr(self, "residual"):
            self.residual = TilingResidual(self._plan([scene]), self.loss)
        self.progress = begin(self.solver, self.residual, y, self.data)

    def likely(self) -> Scene:
        """A scene like those that the fit will go through, to plan for."""
        return tiling_scene(self.progress.y, self.data)

    def _plan(self, scenes: list[Scene]) -> Plan:
        return plan(scenes, height=self.height, width=self.width, coverage=Area("sum"))

    @property
    def y(self) -> Tiling:
        """The best unknowns so far, their mesh untangled."""
        known = bool(jnp.isfinite(self.progress.least))
        return self._mend(self.progress.best if known else self.progress.y)[1]

    def _mend(self, y: Tiling) -> tuple[Mesh, Tiling]:
        moved = np.asarray(vertices_of(y, self.data), np.float64)
        mesh = untangle(self.mesh, moved)
        positions = jnp.asarray(mesh.positions, jnp.float32) / self.data.scale
        return mesh, y._replace(positions=positions)

    def scene(self, *, padded: bool = False) -> Scene:
        """The best scene so far, in pixels of the fit; `padded` by triangles without area."""
        scene = tiling_scene(self.y, self.data)
        drawn = slice(None if padded else self.active)
        return replace(scene, triangles=scene.triangles[drawn], colors=scene.colors[drawn])

    def polish(self) -> None:
        """The best unknowns so far, with the colours of least squared error."""
        y = best_colors(self.residual, self.y, self.data)
        self.progress = forget_best(self.progress._replace(y=y))

    def advance(self, steps: int, room: int) -> np.ndarray:
        """Losses of so many steps; those that outgrew the plan are taken again under a new one."""
        if self.choice.solve:
            y = best_colors(self.residual, self.progress.y, self.data)
            self.progress = self.progress._replace(y=y)
        while True:
            progress, losses, (image, outgrown) = advance(
                self.solver, self.residual, self.progress, self.data, steps=steps, room=room
            )
            if not bool(jnp.any(outgrown)):
                self.progress, self.image = progress, np.asarray(image)
                return np.asarray(losses)
            seen = [tiling_scene(y, self.data) for y in (self.progress.y, progress.y)]
            self.residual = TilingResidual(self._plan(seen), self.loss)

    def refine(self, share: float) -> None:
        """What the host does between chunks, `share` of the way through the fit."""
        due = [part for at, part in _EXCHANGES if self.exchanged < at <= share]
        if self.progress.steps:
            self._untangle()
        if due and self.choice.exchange:
            self.exchanged = share
            self._exchange(max(1, int(due[-1] * len(self.mesh.positions))))
        rate = _RATE * max(_LEAST_RATE, 0.5 + 0.5 * np.cos(np.pi * share))
        self.progress = set_rate(self.progress, float(rate))

    def _untangle(self) -> None:
        """Solvers of second order keep what they know of a point, and go on from it."""
        self.mesh, y = self._mend(self.progress.y)
        if is_first_order(self.solver):
            self.progress = self.progress._replace(y=y)

    def _exchange(self, count: int) -> None:
        """The vertices that matter least go where they matter more."""
        steps = self.progress.steps
        vertices = len(self.mesh.positions)
        mesh = exchange(
            self.mesh, self.target, count, colors=self.choice.colors, weights=self.weights
        )
        if len(mesh.positions) == vertices:
            self._adopt(mesh)
            self.progress = self.progress._replace(steps=steps)


def _altitudes(mesh: Mesh) -> Float[np.ndarray, " vertices"]:
    """Of each vertex, the least altitude of its triangles, in pixels."""
    corners = mesh.positions[mesh.triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, 1), axis=-1).max(1)
    least = np.full(len(mesh.positions), np.inf)
    altitude = 2 * signed_areas(mesh.positions, mesh.triangles) / longest
    np.minimum.at(least, mesh.triangles.ravel(), np.repeat(altitude, 3))
    return least
