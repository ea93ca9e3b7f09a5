"""The fit of a mesh that tiles the canvas.

Between chunks of steps, vertices are moved back until no triangle is flipped. A flipped triangle is
one of reversed orientation. With `start="error"` and without the option `freeze`, vertices are
exchanged a few times during a fit (see `schedule`): those whose removal raises the squared error
least are removed, and as many are inserted where they lower the squared error most. The number of
vertices does not change, so the compiled program can be reused.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...numerics.device import to_device
from ...scene import Scene
from ..closed_form import best_colors
from ..family import AbstractFit, FitRequest
from ..frozen import Mask, freeze, with_frozen
from ..palette import PALETTE_START, Palette, in_palette, palette_of, quantize
from ..solve import begin, forget_best, move, set_learning_rate
from ..steered_state import steered_state
from ..target import Target
from ..trees import fill_tree, tree_arrays
from . import saved, schedule
from .arrays import data_and_unknowns, padded_colors
from .colors import ColorModel
from .early_program import EarlyProgram
from .exchange import exchange
from .full_size import colors_at_full_size
from .initial_mesh import initial_mesh
from .steering import frozen_colors
from .triangulation import Mesh
from .unknowns import (
    MeshData,
    MeshResidual,
    MeshUnknowns,
    mesh_plan,
    mesh_scene,
    vertices_of,
)
from .untangle import untangle

_COLOR_MODELS: dict[str, ColorModel] = {
    "flat": "triangle", "gouraud": "vertex", "linear": "linear",
}  # fmt: skip
"""The colour model (see `colors`) for each value of the option `shading`."""


class _Best(NamedTuple):
    """The best unknowns so far, their loss, and the mesh and data to which they belong.

    `mesh` and `y` have the same positions, in which no triangle is flipped. The loss is infinite if
    it is not known.
    """

    loss: float
    y: MeshUnknowns
    mesh: Mesh
    data: MeshData


class MeshFit(AbstractFit):
    """A fit of the vertex positions and the colours of a mesh that tiles the canvas.

    - `height`, `width`: size of the fit in pixels.

    The base class describes the other attributes and the methods. The constructor also raises
    `ValueError` for a target with alpha, because a mesh covers the canvas.
    """

    data: MeshData

    def __init__(self, request: FitRequest):
        image = request.target.image
        if image.shape[-1] == 4:
            raise ValueError("a mesh covers the canvas: fit targets with alpha by layers.")
        self.request = request
        self.height, self.width = image.shape[:2]
        self._model: ColorModel = _COLOR_MODELS[request.settings["shading"]]
        self.image = image
        self.last_exchange = 0.0
        self._earlier_best: _Best | None = None
        self._palette = palette_of(request.settings["palette"], request.target, request.seed)
        self._is_quantized = False
        early = EarlyProgram(request, self._model)
        mesh = initial_mesh(request, self._model, early)
        data, y = self._arrays(mesh)
        self.residual = early.residual() or MeshResidual(
            mesh_plan([mesh_scene(y, data)], image), request.loss
        )
        self._restart_solver(mesh, data, y)

    @property
    def max_triangles(self) -> int:
        """Number of triangles in use now, which is about the number at the end of the fit.

        A mesh has all of its vertices from the start. The number of triangles changes a little when
        exchanges move vertices to or from the border.
        """
        return self.active

    def _arrays(
        self, mesh: Mesh, scale: Float[np.ndarray, "vertices 1"] | None = None
    ) -> tuple[MeshData, MeshUnknowns]:
        """Make the data and the unknowns of `mesh`, as `arrays.data_and_unknowns` does.

        `scale`: as in `MeshData`; None: it is computed.
        """
        return data_and_unknowns(
            mesh, self.request, self._model, has_fixed_colors=self._is_quantized, scale=scale
        )

    def _frozen_colors(self, mesh: Mesh) -> dict[str, bool | Mask]:
        """Return which colours of `mesh` are frozen now, as `steering.frozen_colors` does."""
        return frozen_colors(mesh, self.request, self._model, has_fixed_colors=self._is_quantized)

    def _restart_solver(self, mesh: Mesh, data: MeshData, y: MeshUnknowns) -> None:
        """Set the mesh, the data and the unknowns of the fit, and begin a new solve from `y`.

        The steps count from 0 again. `data`, `y`: as `_arrays` makes them for `mesh`.
        """
        self.progress = begin(self.request.solver, self.residual, y, data)
        self._mesh, self.data, self.active = mesh, data, len(mesh.triangles)

    def likely_scene(self) -> Scene:
        """The scene of the present unknowns, in pixels of the fit, with spare triangles.

        The spare triangles fill up the arrays and are not visible. The cost of drawing the scene
        hardly changes during a fit, because the mesh has all vertices from the start.
        """
        return mesh_scene(self.progress.y, self.data)

    def _best(self) -> _Best:
        """The unknowns with the least loss so far, moved so that no triangle is flipped.

        If no loss is known yet, they are the present unknowns, with a loss of infinity.
        """
        loss = float(self.progress.best_loss)
        if self._earlier_best is not None and not self._earlier_best.loss > loss:
            return self._earlier_best
        y = self.progress.best if np.isfinite(loss) else self.progress.y
        mesh, y = _untangled(y, self._mesh, self.data)
        return _Best(loss, y, mesh, self.data)

    def scene(self, *, padded: bool = False) -> Scene:
        """The scene with the least loss so far, in pixels of the fit, without flipped triangles.

        If the fit has a palette, all triangles have its colours. `padded`: keep the spare
        triangles, which have no area.
        """
        best = self._best()
        return self._scene_of(best, None if padded else len(best.mesh.triangles))

    def current_scene(self) -> Scene:
        """The scene of the present unknowns, in pixels of the fit, without spare triangles.

        Vertices are moved back until no triangle is flipped.
        """
        mesh, y = _untangled(self.progress.y, self._mesh, self.data)
        return self._scene_of(_Best(np.inf, y, mesh, self.data), len(mesh.triangles))

    def go_on_from(self, scene: Scene) -> None:
        """Move the vertices towards the positions in `scene`, and take its colours.

        Vertices move only as far as no triangle is flipped, and what is frozen stays. If triangles
        already have colours of the palette, each colour is replaced by the nearest colour of the
        palette. With one colour per vertex, a vertex takes the colour of its corner in the last
        triangle of `scene` that contains this vertex. The best unknowns so far are forgotten.

        `scene`: in pixels of the fit, with the triangles of `current_scene`.
        """
        # A coordinate whose goal is NaN stays.
        goals = np.where(self.data.free, np.asarray(scene.positions, np.float64), np.nan)
        mesh = untangle(self._mesh, goals)
        positions = mesh.positions.astype(np.float32) / np.asarray(self.data.scale)
        unknowns = with_frozen(self.progress.y, self.data.frozen)
        colors = np.array(unknowns.colors)
        if self._model == "vertex":
            colors[mesh.triangles] = np.asarray(scene.colors)
        else:
            colors[: self.active] = np.asarray(scene.colors)
        if self._is_quantized and self._palette is not None:
            colors = in_palette(self._palette, colors)
        y = MeshUnknowns(to_device(positions), to_device(colors))
        if self.request.may_freeze:
            frozen = frozen_colors(mesh, self.request, self._model, has_fixed_colors=False)
            y = with_frozen(y, freeze(unknowns, frozen))
            self.data = self.data._replace(frozen=freeze(y, self._frozen_colors(mesh)))
        self._mesh, self._earlier_best = mesh, None
        self.progress = forget_best(
            move(self.request.solver, self.residual, self.progress, y, self.data)
        )

    def _scene_of(self, best: _Best, count: int | None) -> Scene:
        """Make the scene of the first `count` triangles of `best`; of all triangles for None.

        If there is a palette, each colour is replaced by the nearest colour of the palette.
        """
        y = best.y
        if self._palette is not None and not self._is_quantized:
            y = y._replace(colors=in_palette(self._palette, y.colors))
        scene = mesh_scene(y, best.data)
        rows = slice(count)
        triangles, colors = (
            to_device(np.asarray(array)[rows]) for array in (scene.triangles, scene.colors)
        )
        return replace(scene, triangles=triangles, colors=colors)

    def polish(self) -> None:
        """Replace the unknowns by the best so far, with the colours of least squared error.

        The squared error is computed at the size of the fit, in the colour space of the loss.
        Frozen colours stay. `residual` is replaced if its plan is too small for these unknowns. The
        record of the best unknowns is cleared, because its loss is that of other colours.
        """
        _, y, self._mesh, self.data = self._best()
        self.active, self._earlier_best = len(self._mesh.triangles), None
        # The best unknowns may be older than the last exchange, and outgrow the present plan.
        plan_for_best = mesh_plan([mesh_scene(y, self.data)], self.request.target.image)
        if not self.residual.plan.holds(plan_for_best):
            self.residual = MeshResidual(plan_for_best, self.request.loss)
        y = best_colors(self.residual, y, self.data, self.request.loss.light)
        progress = move(self.request.solver, self.residual, self.progress, y, self.data)
        self.progress = forget_best(progress)

    def polish_at_full_size(self, target: Target) -> None:
        """Replace the unknowns by the best so far, with colours that suit the pixels of `target`.

        `target`: the image and its weights at their original size. The colours minimise the
        weighted squared error of sRGB values, and are then clipped to 0..1. Frozen colours stay.
        The record of the best unknowns is cleared, because its loss is that of other colours.
        """
        _, y, self._mesh, self.data = self._best()
        self.active, self._earlier_best = len(self._mesh.triangles), None
        height, width = target.image.shape[:2]
        factors = np.array([width / self.width, height / self.height])
        enlarged = self._mesh._replace(positions=self._mesh.positions * factors)
        colors = colors_at_full_size(enlarged, target, model=self._model)
        y = y._replace(
            colors=padded_colors(np.clip(colors, 0, 1), self._model, len(self.data.triangles))
        )
        progress = move(self.request.solver, self.residual, self.progress, y, self.data)
        self.progress = forget_best(progress)

    def replan(self, reached: Sequence[tuple[MeshUnknowns, MeshData]]) -> MeshResidual:
        """Return a residual whose plan has capacity for the scenes of the unknowns in `reached`.

        A plan (`mesh_plan`) fixes the sizes of the arrays with which scenes are drawn. The fit
        itself does not change. `reached`: pairs `(unknowns, data)`.
        """
        plan = mesh_plan([mesh_scene(y, data) for y, data in reached], self.request.target.image)
        return MeshResidual(plan, self.request.loss)

    def refine(self, share: float) -> None:
        """Do what the schedule and the options ask for before a chunk of steps.

        It does these in order:

        - move vertices back until no triangle is flipped (`_untangle`);
        - exchange vertices (`_exchange`), when that is due and the options allow it;
        - set the learning rate, if the solver has one that may be lowered;
        - assign colours of the palette, if there is one and `share` has reached `PALETTE_START`.

        `share`: share of the fit that is done, 0..1.
        """
        if self.progress.steps:
            self._untangle()
        vertices = len(self._mesh.positions)
        count = schedule.vertices_to_exchange(share, self.last_exchange, vertices)
        if count and self.request.exchanges:
            self.last_exchange = share
            self._exchange(count)
        if self.request.adjustable_rate:
            self.progress = set_learning_rate(self.progress, schedule.learning_rate(share))
        if self._palette is not None and (self._is_quantized or share >= PALETTE_START):
            self._quantize(self._palette)

    def _untangle(self) -> None:
        """Move vertices back until no triangle is flipped.

        If the request's `adjustable_rate` is true, the unknowns are set to the new positions. Other
        solvers may remember their last point, so for them only `_mesh` changes, which the next
        exchange uses.
        """
        self._mesh, y = _untangled(self.progress.y, self._mesh, self.data)
        if self.request.adjustable_rate:
            self.progress = self.progress._replace(y=y)

    def _exchange(self, count: int) -> None:
        """Remove up to `count` vertices, and insert as many where they lower the error most.

        `exchange.exchange` says how. The best unknowns before the exchange, if a loss is known, are
        remembered. A new solve begins on the new mesh, but the number of steps stays. Nothing
        changes if fewer vertices could be inserted than were removed.
        """
        steps = self.progress.steps
        mesh = exchange(self._mesh, self.request.target, count, model=self._model)
        if len(mesh.positions) == len(self._mesh.positions):
            if np.isfinite(self.progress.best_loss):
                self._earlier_best = self._best()
            self._restart_solver(mesh, *self._arrays(mesh))
            self.progress = self.progress._replace(steps=steps)

    def _quantize(self, palette: Palette) -> None:
        """Give each triangle a colour of the palette, for a low squared error, and freeze colours.

        The palette is improved, too, unless the user gave its colours. Losses with different frozen
        colours are not comparable. Therefore the best unknowns so far are forgotten when colours
        change. After the first call, nothing is done if all colours and the palette would change by
        less than `palette.LEAST_CHANGE`.
        """
        y = with_frozen(self.progress.y, self.data.frozen)
        quantized = quantize(
            self.residual, y, self.data._replace(frozen=None), self.request.target, palette,
            improves_palette=self.request.finds_palette, quantizes_background=False,
        )  # fmt: skip
        if self._is_quantized and quantized.is_close(np.asarray(y.colors), palette):
            return
        self._is_quantized = True
        self._palette, self._earlier_best = quantized.palette, None
        y = y._replace(colors=to_device(quantized.colors[:, None]))
        self.data = self.data._replace(frozen=freeze(y, self._frozen_colors(self._mesh)))
        self.progress = forget_best(
            move(self.request.solver, self.residual, self.progress, y, self.data)
        )

    def family_state(self) -> dict[str, np.ndarray]:
        """Return the arrays, by name, that are saved for a fit of a mesh only.

        - `mesh.positions`, `mesh.triangles`, `mesh.free_x`, `mesh.free_y`: the fields of the
          present mesh.
        - `scale`: as in `MeshData`.
        - `kept`, `kept.0`, `kept.1`, `kept.mesh.positions`, ..., `kept.scale`: loss, unknowns, mesh
          and scale of the best unknowns before the last exchange, if there are any.
        - The arrays of `steered_state`.
        """
        # The scale was computed at the last exchange, so it does not follow from the mesh.
        arrays = {"scale": np.asarray(self.data.scale)} | saved.mesh_arrays("mesh", self._mesh)
        if self._earlier_best is not None:
            arrays["kept"] = np.array(self._earlier_best.loss)
            arrays |= tree_arrays("kept", self._earlier_best.y)
            arrays |= saved.mesh_arrays("kept.mesh", self._earlier_best.mesh)
            arrays["kept.scale"] = np.asarray(self._earlier_best.data.scale)
        return arrays | steered_state(self._palette, self._is_quantized, self.data.frozen)

    def restore_family_state(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore what `family_state` returned, from `arrays`, the arrays of the saved fit by name.

        The constructor has restored the present mesh already. Raises `ValueError` for unknowns of
        other shapes or types than this fit has.
        """
        self.data = self.data._replace(scale=to_device(arrays["scale"]))
        self._palette = arrays.get("palette")
        self._is_quantized = bool(arrays.get("quantized", False))
        if self.data.frozen is not None:
            values = fill_tree(self.progress.y, "frozen", arrays)
            self.data = self.data._replace(frozen=freeze(values, self._frozen_colors(self._mesh)))
        if "kept" in arrays:
            mesh = saved.mesh_of(arrays, "kept.mesh")
            data, template = self._arrays(mesh, arrays["kept.scale"])
            y = fill_tree(template, "kept", arrays)
            self._earlier_best = _Best(float(arrays["kept"]), y, mesh, data)


def _untangled(y: MeshUnknowns, mesh: Mesh, data: MeshData) -> tuple[Mesh, MeshUnknowns]:
    """Move the vertices of a mesh towards the positions in `y`, as far as no triangle is flipped.

    `data`: the data to which `y` belongs. Returns the moved mesh, and `y` with its positions.
    """
    mesh = untangle(mesh, np.asarray(vertices_of(y, data), np.float64))
    positions = mesh.positions.astype(np.float32) / np.asarray(data.scale)
    return mesh, y._replace(positions=to_device(positions))
