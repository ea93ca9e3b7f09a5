"""The fit of layers: free triangles, which are added and moved to where the error is large.

The arrays of triangles have one length for the whole fit: `sizes` and `spare` make them. `schedule`
says when triangles are added and exchanged.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ...color import premultiply
from ...numerics.device import to_device
from ...planning.size_classes import unknowns_class
from ...scene import Scene
from .. import choices
from ..closed_form import best_colors
from ..family import AbstractFit, FitRequest
from ..frozen import freeze, with_frozen
from ..palette import (
    LEAST_CHANGE,
    PALETTE_START,
    Palette,
    best_background,
    in_palette,
    palette_of,
    quantize,
)
from ..solve import begin, forget_best, move, set_learning_rate
from ..steered_state import steered_state
from ..steering import check_length
from ..target import Target
from ..trees import fill_tree
from ..units import POSITION_UNIT
from . import saved, schedule
from .canvas import OVERSHOOT, near_canvas, overshoot_of
from .exchange import Replacement, find_exchange
from .placement import find_new_triangles
from .sizes import FitSizes
from .start import background_of, start_of
from .steering import frozen_fields, has_palette_background
from .unknowns import LayersData, LayersResidual, LayersUnknowns, layers_scene


class _EarlierBest(NamedTuple):
    """The best unknowns before triangles were last added or replaced, and their loss."""

    loss: float
    y: LayersUnknowns


class LayersFit(AbstractFit):
    """A fit of free triangles, flat or with corner colours, opaque or translucent.

    `height`, `width`: size of the fit in pixels. The base class describes the other attributes and
    the methods.
    """

    data: LayersData

    def __init__(self, request: FitRequest):
        self.request = request
        image, settings = request.target.image, request.settings
        self.height, self.width = image.shape[:2]
        state = request.resume_state
        length = unknowns_class(self.max_triangles) if state is None else saved.length_of(state)
        self._sizes = FitSizes.of(self.height, self.width, length, settings)
        # The triangles of a resumed fit come from its state, in `restore_family_state`; here only
        # the shapes matter.
        start = request.start if state is None else "uniform"
        self._rng = np.random.default_rng(request.seed)
        self._background = background_of(settings["background"], start, request.target)
        weights = request.target.weights
        self.data = LayersData(
            request.loss.prepare(to_device(image)),
            None if weights is None else to_device(weights, np.float32),
            to_device(self._background),
            to_device(settings["softness"][0], np.float32),
        )
        y, self.active = self._initial_unknowns(start)
        self._palette = palette_of(settings["palette"], request.target, request.seed)
        self._is_quantized = False
        if state is None and "triangles" in request.masks:
            check_length("triangles", request.masks["triangles"], self.active)
        self._freeze(y)
        self._overshoot = OVERSHOOT
        if isinstance(start, Scene):
            corners = np.asarray(y.corners[: self.active])
            self._overshoot = max(OVERSHOOT, overshoot_of(corners, self.height, self.width))
        self.residual = LayersResidual(self._sizes.plan([self.likely_scene()]), request.loss)
        self.progress = begin(request.solver, self.residual, y, self.data)
        self._earlier_best: _EarlierBest | None = None
        self.image = np.broadcast_to(self._background, image.shape)
        self.last_exchange = 0.0

    @property
    def max_triangles(self) -> int:
        """Largest number of triangles in use at the end of the fit: the option `triangles`."""
        return self.request.settings["triangles"]

    def _initial_unknowns(self, start: str | Scene) -> tuple[LayersUnknowns, int]:
        """Make the unknowns to start from; return them and the number of triangles in use.

        Raises `ValueError` for an unsuitable `start`, which is as in `FitRequest`.
        """
        count = self.max_triangles
        triangles = start_of(
            start, self.request.target, self._rng, triangles=count,
            gouraud=self._sizes.gouraud, translucent=self._sizes.translucent,
            circumradius=self._sizes.circumradius(count),
        )  # fmt: skip
        return self._sizes.unknowns(triangles), len(triangles.corners)

    def _freeze(self, y: LayersUnknowns) -> None:
        """Freeze what the options `freeze` and `palette` ask for, at the values in `y`.

        A palette freezes the colours only after the triangles have got colours of the palette.
        """
        if self.request.may_freeze:
            masks = frozen_fields(self.request, has_fixed_colors=self._is_quantized)
            self.data = self.data._replace(frozen=freeze(y, masks))

    def _with_frozen_values(self, y: LayersUnknowns) -> LayersUnknowns:
        """Replace the frozen numbers in `y` by the values at which they were frozen."""
        return with_frozen(y, self.data.frozen)

    def likely_scene(self) -> Scene:
        """Make a scene of `max_triangles` large random triangles, followed by the spare ones."""
        return self._sizes.likely_scene(self.data.background)

    @property
    def _best(self) -> LayersUnknowns:
        """The unknowns with the least loss so far; frozen numbers have their fixed values.

        If no loss is known yet, they are the present unknowns.
        """
        loss = float(self.progress.best_loss)
        if self._earlier_best is not None and not self._earlier_best.loss > loss:
            return self._earlier_best.y
        return self._with_frozen_values(
            self.progress.best if np.isfinite(loss) else self.progress.y
        )

    def scene(self, *, padded: bool = False) -> Scene:
        """The scene with the least loss so far, in pixels of the fit.

        If there is a palette, each colour is the nearest one of the palette. `padded`: keep the
        spare triangles, which lie outside the canvas.
        """
        return self._scene_of(self._best, slice(None if padded else self.active))

    def current_scene(self) -> Scene:
        """The scene of the present unknowns, in pixels of the fit, with triangles in use alone."""
        return self._scene_of(self._with_frozen_values(self.progress.y), slice(self.active))

    def go_on_from(self, scene: Scene) -> None:
        """Continue from `scene` and its background, and forget the best unknowns so far.

        Frozen unknowns keep their values. Once triangles have colours of the palette, each colour
        becomes the nearest of the palette. A triangle's opacity becomes its corners' mean alpha.
        """
        corners, colors = scene.positions[scene.triangles] / POSITION_UNIT, scene.colors[..., :3]
        if self._is_quantized and self._palette is not None:
            colors = in_palette(self._palette, colors)
        unknowns, in_use = self._with_frozen_values(self.progress.y), slice(self.active)
        y = unknowns._replace(
            corners=unknowns.corners.at[in_use].set(corners),
            colors=unknowns.colors.at[in_use].set(colors),
        )
        if unknowns.opacity is not None:
            # A scene has alpha per corner; the fit has one opacity per triangle.
            opacity = scene.colors[..., 3].mean(1)
            y = y._replace(opacity=unknowns.opacity.at[in_use].set(opacity))
        y = with_frozen(y, freeze(unknowns, frozen_fields(self.request, has_fixed_colors=False)))
        self._freeze(y)
        self._background = np.asarray(scene.background)
        self.data = self.data._replace(background=scene.background)
        self._go_to(y)

    def _go_to(self, y: LayersUnknowns) -> None:
        """Continue the solve from the unknowns `y`, and forget the best unknowns so far."""
        self._earlier_best = None
        progress = move(self.request.solver, self.residual, self.progress, y, self.data)
        self.progress = forget_best(progress)

    def _scene_of(self, y: LayersUnknowns, triangles: slice) -> Scene:
        """Make the scene of some triangles of `y`, clipped as `canvas.near_canvas` does.

        If there is a palette, the scene has its colours. `triangles`: which triangles to take.
        """
        y = jax.tree.map(lambda leaf: leaf[triangles], y)
        background = self.data.background
        if self._palette is not None and not self._is_quantized:
            y = y._replace(colors=in_palette(self._palette, y.colors))
            if has_palette_background(self.request, self._background):
                background = in_palette(self._palette, background)
        return layers_scene(y._replace(corners=self._near_canvas(y.corners)), background)

    def polish(self) -> None:
        """Replace the unknowns by the best so far, with the colours of least squared error."""
        y, loss = self._best, self.request.loss
        # The best unknowns may be older than the last exchange, and outgrow the present plan.
        plan_for_best = self._sizes.plan(
            [self.likely_scene(), layers_scene(y, self.data.background)]
        )
        if not self.residual.plan.holds(plan_for_best):
            self.residual = LayersResidual(plan_for_best, loss)
        y = best_colors(self.residual, y, self.data, loss.light)
        self._go_to(y)

    def replan(self, reached: Sequence[tuple[LayersUnknowns, LayersData]]) -> LayersResidual:
        """Return a residual whose plan has capacity for the scenes of the unknowns in `reached`.

        The plan has capacity for `likely_scene`, too. `reached`: pairs `(unknowns, data)`.
        """
        scenes = [layers_scene(with_frozen(y, data.frozen), data.background) for y, data in reached]
        return LayersResidual(self._sizes.plan([self.likely_scene(), *scenes]), self.request.loss)

    def refine(self, share: float) -> None:
        """Do what the schedule and the options ask for before a chunk of steps.

        In this order: set the width of soft edges; with Adam, set the learning rate and clip
        corners (`canvas.near_canvas`); add or exchange triangles; fit the background; assign
        colours of the palette. `share`: share of the fit that is done, 0..1.
        """
        self._sharpen(share)
        if self.request.adjustable_rate:
            self.progress = set_learning_rate(self.progress, schedule.learning_rate(share))
            y = self.progress.y
            is_spare = jnp.arange(self._sizes.length)[:, None, None] >= self.active
            corners = jnp.where(is_spare, y.corners, self._near_canvas(y.corners))
            self.progress = self.progress._replace(y=y._replace(corners=corners))
        if self.request.places_by_error:
            self._add_or_exchange(share)
        if self.request.settings["background"] == "fit" and not self._is_quantized:
            self._fit_background()
        if self._palette is not None and (self._is_quantized or share >= PALETTE_START):
            self._quantize(self._palette)

    def _add_or_exchange(self, share: float) -> None:
        """Add triangles or, once all are in use, exchange some, if due at this share of the fit."""
        max_triangles = self.max_triangles
        count = schedule.triangles_to_add(share, self.active, max_triangles)
        if count:
            self._add(count)
        elif not self.request.exchanges or self.active < max_triangles:
            return
        elif schedule.is_exchange_due(share, self.last_exchange):
            self.last_exchange = share
            self._exchange(schedule.triangles_to_exchange(share, max_triangles))

    def retarget(self, target: Target, data: LayersData) -> None:
        """Begin a new solve for another target of the same size, from the best unknowns so far.

        - `target`: the target, at the size of the fit, with which the image is compared for the
          history.
        - `data`: the data of the residual, with the target and weights that the solver is to fit.

        After this call, no triangle is added or exchanged.
        """
        # With this start, `request.places_by_error` is false.
        settings = self.request.settings | {"start": choices.FROM_OBJECT}
        y, self._earlier_best = self._best, None
        self.request, self.data = self.request._replace(target=target, settings=settings), data
        self.progress = begin(self.request.solver, self.residual, y, data)

    def _sharpen(self, share: float) -> None:
        """Set the width of soft edges for the share of the fit that is done, `share` in 0..1.

        A new width makes losses incomparable, so it forgets the best unknowns so far.
        """
        width = schedule.edge_width(share, self._sizes.softness)
        if width != np.float32(self.data.width):
            self.data = self.data._replace(width=to_device(width))
            self._go_to(self.progress.y)

    def _near_canvas(self, corners: Float[Array, "..."]) -> Float[Array, "..."]:
        """Clip corners, in units of the unknowns, as `canvas.near_canvas` does."""
        return near_canvas(corners, self._overshoot, self.height, self.width)

    def _add(self, count: int) -> None:
        """Add up to `count` triangles in front, where they lower the squared error most."""
        circumradius = self._sizes.circumradius(self.active + count)
        target = self.request.target.premultiplied()
        image, palette = premultiply(self.image), self._placing_palette
        new_triangles = find_new_triangles(
            self._rng, image, target, count, circumradius=circumradius, palette=palette
        )
        if len(new_triangles.corners):
            order = np.arange(self._sizes.length)
            self._replace(
                Replacement(order, self.active, new_triangles.corners, new_triangles.colors)
            )
            self.active += len(new_triangles.corners)

    @property
    def _placing_palette(self) -> Palette | None:
        """The colours that a new triangle may have; None means any colour.

        It is None until the triangles have got colours of the palette.
        """
        return self._palette if self._is_quantized else None

    def _exchange(self, count: int) -> None:
        """Replace up to `count` triangles by new ones in front, which `find_exchange` chooses."""
        replacement = find_exchange(
            self._rng, self._with_frozen_values(self.progress.y), premultiply(self.image),
            self.request.target.premultiplied(), self._background, count, active=self.active,
            circumradius=self._sizes.exchanged_circumradius(self.active),
            palette=self._placing_palette,
        )  # fmt: skip
        if replacement is not None:
            self._replace(replacement)

    def _replace(self, replacement: Replacement) -> None:
        """Add or replace triangles, as `replacement` says, in the unknowns and the solver's state.

        The loss may rise afterwards, so the best unknowns before that are remembered. Solvers other
        than Adam restart.
        """
        if np.isfinite(self.progress.best_loss):
            earlier_loss = np.inf if self._earlier_best is None else self._earlier_best.loss
            best_loss = min(float(self.progress.best_loss), earlier_loss)
            self._earlier_best = _EarlierBest(best_loss, self._best)
        y = replacement.apply_to_unknowns(self._with_frozen_values(self.progress.y))
        self._freeze(y)
        if self.request.adjustable_rate:
            # Adam's moving averages have one number per unknown, and start at 0 for new ones.
            solver_state = replacement.apply_to_optimizer_state(self.progress.state)
            self.progress = forget_best(self.progress._replace(y=y, state=solver_state))
        else:
            restarted = begin(self.request.solver, self.residual, y, self.data)
            self.progress = restarted._replace(steps=self.progress.steps)

    def _fit_background(self) -> None:
        """Set the background to the colour that `palette.best_background` computes.

        A new background makes losses incomparable, so it forgets the best unknowns so far. Nothing
        is done if all channels would change by less than `palette.LEAST_CHANGE`.
        """
        y, target = self._with_frozen_values(self.progress.y), self.request.target.premultiplied()
        data = self.data._replace(frozen=None)
        background = best_background(self.residual, y, data, target)
        if np.abs(background - self._background).max() < LEAST_CHANGE:
            return
        self._background = background
        self.data = self.data._replace(background=to_device(background))
        self._go_to(y)

    def _quantize(self, palette: Palette) -> None:
        """Give each triangle a colour of the palette, for a low squared error, and freeze colours.

        The palette is improved, too, unless the user gave its colours. The background gets a colour
        of the palette if `has_palette_background` says so. Losses of before and after cannot be
        compared, so the best unknowns so far are forgotten. After the first call, nothing is done
        if triangles and palette would change by less than `LEAST_CHANGE` (`palette.py`).
        """
        y = self._with_frozen_values(self.progress.y)
        quantized = quantize(
            self.residual, y, self.data._replace(frozen=None), self.request.target.premultiplied(),
            palette, improves_palette=self.request.finds_palette,
            quantizes_background=has_palette_background(self.request, self._background),
        )  # fmt: skip
        if self._is_quantized and quantized.is_close(np.asarray(y.colors), palette):
            return
        self._is_quantized = True
        self._palette, self._background = quantized.palette, quantized.background
        y = y._replace(colors=to_device(quantized.colors[:, None]))
        self.data = self.data._replace(background=to_device(quantized.background))
        self._freeze(y)
        self._go_to(y)

    def family_state(self) -> dict[str, np.ndarray]:
        """Return the arrays to be saved, by name, that `state.save_state` does not make itself.

        `saved.pack` and, for a palette and for frozen unknowns, `steered_state` say which they are.
        """
        earlier = self._earlier_best
        best = None if earlier is None else (earlier.loss, earlier.y)
        arrays = saved.pack(best, self._overshoot, self.data.width, self._background, self._rng)
        return arrays | steered_state(self._palette, self._is_quantized, self.data.frozen)

    def restore_family_state(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore what `family_state` returned; the unknowns have been restored before."""
        # Names in the file format do not change when fields are renamed.
        self._background, self._overshoot = arrays["background"], float(arrays["beyond"])
        self.data = self.data._replace(
            background=to_device(self._background), width=to_device(arrays["width"])
        )
        saved.restore_generator(self._rng, arrays)
        self._palette = arrays.get("palette")
        self._is_quantized = bool(arrays.get("quantized", False))
        if self.data.frozen is not None:
            self._freeze(fill_tree(self.progress.y, "frozen", arrays))
        best = saved.unpack_best(self.progress.y, arrays)
        if best is not None:
            self._earlier_best = _EarlierBest(*best)
