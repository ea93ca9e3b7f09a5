"""The interface of a fit family, of which there are two: free layers and meshes.

A fit alternates between two kinds of work. A chunk of solver steps runs as one compiled program and
changes only the unknowns. Between chunks, the family does on the host what a solver cannot do: it
adds triangles, moves them where the error is, or repairs a mesh. `loop.run` drives both through the
methods below.

To add a family, write an `AbstractFit`, and add a row to `traits.TRAITS` and `families.FAMILIES`.
"""

import abc
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, get_args

import numpy as np

from .. import names
from ..scene import Scene
from .entries import Entries, Size
from .frozen import Mask
from .loss import Loss
from .solve import Progress, Residual
from .solvers import Solver
from .target import Image, Target


class FitRequest(NamedTuple):
    """Everything that a family needs to make a fit that has not taken a step.

    - `target`: the image and its weights, at the size of the fit.
    - `settings`: the arguments of `fit`, checked and completed (see `choices`).
    - `start`: the name of a start, a `Scene` in pixels of the fit, or a `Mesh`.
    - `seed`: of all random choices.
    - `adjustable_rate`: whether the solver has a learning rate that the family may lower.
    - `resume_state`: arrays of an earlier fit, or None for a new fit. The family reads here only
      the shapes of its arrays; `AbstractFit.restore_family_state` restores their values later.
    - `masks`: which `"vertices"` and `"triangles"` are frozen, if the option `freeze` has any.
    - `must_start()`: whether time is up for the search for a start, so that steps must begin.
    """

    target: Target
    settings: dict[str, Any]
    start: Any
    loss: Loss
    solver: Solver
    seed: int
    adjustable_rate: bool
    resume_state: dict[str, np.ndarray] | None
    must_start: Callable[[], bool]
    masks: Mapping[str, Mask]

    @property
    def exchanges(self) -> bool:
        """Whether, between chunks, triangles or vertices are moved to where the error is large.

        Never if anything is frozen.
        """
        return self.places_by_error and not self.settings["freeze"]

    @property
    def places_by_error(self) -> bool:
        """Whether triangles or vertices are placed where the error is large."""
        return self.settings["start"] == "error"

    @property
    def may_freeze(self) -> bool:
        """Whether some unknowns are frozen, now or later in the fit."""
        return bool(self.settings["freeze"]) or self.settings["palette"] is not None

    @property
    def starts_from_object(self) -> bool:
        """Whether the fit starts, or once started, from a scene or a mesh that was given."""
        start = self.settings["start"]
        return not isinstance(start, str) or start not in get_args(names.FitStart)

    @property
    def finds_palette(self) -> bool:
        """Whether the colours of the palette are to be found, too."""
        return isinstance(self.settings["palette"], int)

    @property
    def solves_colors(self) -> bool:
        """Whether colours are solved for in closed form before each chunk."""
        return self.settings["colors"] == "solve"


class AbstractFit(abc.ABC):
    """A fit between two chunks of steps.

    The constructor of a family takes a `FitRequest`, builds the start, plans for it and sets all of
    the attributes below. It raises `ValueError` for a start that does not suit the family.

    - `request`: the request from which the fit was made.
    - `residual`, `data`: the function that the solver minimises, and its second argument. Beside
      the residual, the function returns `(image, outgrown)`, which `chunk.advance_fits` reads.
      `data` holds arrays that may change between chunks without compiling again.
    - `progress`: unknowns, solver state and number of steps.
    - `image`: the image of the last step, at the size and with the coverage of the fit.
    - `active`: number of triangles in use; the other triangles in the arrays are spare.
    - `last_exchange`: how far the fit was, 0..1, when triangles or vertices were last moved to
      where the error is large.
    """

    request: FitRequest
    residual: Any
    data: Any
    progress: Progress
    image: Image
    active: int
    last_exchange: float

    @property
    @abc.abstractmethod
    def max_triangles(self) -> int:
        """Largest number of triangles that the fit can have at its end."""

    @abc.abstractmethod
    def likely_scene(self) -> Scene:
        """Make a scene, in pixels of the fit, that is about as costly to draw as later ones.

        Capacities are planned for it, and programs are compiled for its shapes.
        """

    @abc.abstractmethod
    def scene(self, *, padded: bool = False) -> Scene:
        """The best scene so far, in pixels of the fit.

        `padded`: keep the spare triangles, which do not show, so that all scenes of a fit have the
        same shapes and share a program.
        """

    @abc.abstractmethod
    def current_scene(self) -> Scene:
        """The scene of the last unknowns, in pixels of the fit, without spare triangles."""

    @abc.abstractmethod
    def go_on_from(self, scene: Scene) -> None:
        """Continue from a scene with the same triangles as `current_scene`, and forget the best.

        The scene is in pixels of the fit. What is frozen stays, colours become those of the
        palette, and a mesh moves only as far as no triangle is flipped.
        """

    @abc.abstractmethod
    def replan(self, reached: list[Any]) -> Residual:
        """Make a residual with capacity for all of these unknowns, without changing the fit."""

    @abc.abstractmethod
    def refine(self, share: float) -> None:
        """Improve the fit between two chunks, on the host.

        With the option `palette`, this chooses the colour of each triangle anew
        (`palette.quantize`), and freezes it for the chunk (`frozen.Frozen`). All scenes of such a
        fit have colours of the palette, also the first one.

        `share`: how far the fit is, 0..1. `progress` and `data` may change, but not the shapes of
        their arrays, so that the compiled program can be used again.
        """

    @abc.abstractmethod
    def polish(self) -> None:
        """Replace the unknowns by the best so far, with colours solved for least squared error.

        `residual` is replaced too if its plan is too small for these unknowns.
        """

    def polish_at_full_size(self, target: Target) -> None:  # noqa: B027
        """Improve the best unknowns for a `target` larger than the fit, at the end of the fit.

        Only families that gain by it do anything.
        """

    @abc.abstractmethod
    def family_state(self) -> dict[str, np.ndarray]:
        """Arrays that only fits of this family save; `state.save_state` adds those of all fits.

        Their names are part of the file format.
        """

    @abc.abstractmethod
    def restore_family_state(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore what `family_state` saved; `state.restore_state` has restored the rest before.

        Raises `ValueError` for arrays of other shapes or types than this fit has.
        """


class Family(NamedTuple):
    """A row of the table of families.

    - `make`: the constructor.
    - `unknowns`: makes the pytree of unknowns from its leaves.
    - `check_state`: checks the entries that `family_state` saved, for the settings, the size and
      the number of active triangles of the fit. It returns the shapes of the unknowns, or raises
      `ValueError`.
    """

    make: Callable[[FitRequest], AbstractFit]
    unknowns: Callable[[list[Any]], Any]
    check_state: Callable[[Entries, dict[str, Any], Size, int], list[tuple[int, ...]]]
