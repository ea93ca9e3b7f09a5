"""The interface of a fit family: what the loop asks of free layers and of a mesh.

A fit alternates between two kinds of work. A chunk of solver steps runs as one compiled program
and changes only the unknowns. Between chunks, the family does on the host what a solver cannot:
it adds triangles, moves them where the error is, or repairs a mesh. `loop.run` drives both through
the methods below.

To add a family, write an `AbstractFit` and add a row to `families.FAMILIES`.
"""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..scene import Scene
from .entries import Entries, Size
from .loss import Loss
from .solve import Progress, Residual
from .solvers import Solver
from .target import Image, Target


class FitRequest(NamedTuple):
    """Everything from which a family makes a fit that has not taken a step.

    - `target`: the image and its weights, at the size of the fit.
    - `settings`: the arguments of `fit`, checked and settled (see `choices`).
    - `start`: a word, a `Scene` in pixels of the fit, or a `Mesh`.
    - `seed`: of all random choices.
    - `adjustable_rate`: whether the solver has a learning rate that the family may lower.
    - `resume_state`: arrays of an earlier fit, restored later by `AbstractFit.restore_own_state`;
      the family reads here only the sizes of its arrays. None for a new fit.
    - `must_start()`: whether a start that is still being searched for must be taken as it is.
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

    @property
    def exchanges(self) -> bool:
        """Whether triangles or vertices are moved to where the error is, as the fit goes on."""
        return self.settings["start"] == "error"

    @property
    def solves_colors(self) -> bool:
        """Whether colours are solved for in closed form before each chunk."""
        return self.settings["colors"] == "solve"


class AbstractFit(abc.ABC):
    """A fit between two chunks of steps.

    The constructor of a family takes a `FitRequest`, builds the start, plans for it and sets all of
    the attributes below. It raises `ValueError` for a start that does not suit the family.

    - `request`: what the fit was made from.
    - `residual`, `data`: the function that the solver lowers, and its second argument. The function
      gives `(image, outgrown)` beside the residual, as `chunk.advance` expects. `data` holds arrays
      that may change between chunks without compiling again.
    - `progress`: unknowns, solver state and number of steps.
    - `image`: the image that the last step saw, at the size and with the coverage of the fit.
    - `active`: number of triangles in use; the others are spare entries of the arrays.
    - `last_exchange`: share of the fit, 0..1, at which triangles or vertices were last moved
      elsewhere.
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
        """Largest number of triangles that the fit may come to have."""

    @abc.abstractmethod
    def likely_scene(self) -> Scene:
        """A scene, in pixels of the fit, as costly to draw as those that the fit will go through.

        Capacities are planned for it, and programs are compiled for its shapes.
        """

    @abc.abstractmethod
    def scene(self, *, padded: bool = False) -> Scene:
        """The best scene so far, in pixels of the fit.

        `padded`: keep the spare triangles, which do not show, so that all scenes of a fit have the
        same shapes and share a program.
        """

    @abc.abstractmethod
    def replan(self, reached: list[Any]) -> Residual:
        """A residual with enough capacity for all of these unknowns. Changes nothing."""

    @abc.abstractmethod
    def refine(self, share: float) -> None:
        """Do what comes between two chunks, on the host.

        `share`: how far the fit is, 0..1. Changes `progress` and `data` such that the shapes of
        their arrays stay, and with them the compiled program.
        """

    @abc.abstractmethod
    def polish(self) -> None:
        """Go to the best unknowns so far, with the colours of least squared error for them."""

    @abc.abstractmethod
    def own_state(self) -> dict[str, np.ndarray]:
        """Arrays to save of this family alone; `state.save_state` adds those that all fits have.

        Their names are part of the file format.
        """

    @abc.abstractmethod
    def restore_own_state(self, arrays: dict[str, np.ndarray]) -> None:
        """Undo `own_state`, after `state.restore_state` has restored what all fits have.

        Raises `ValueError` for arrays of other shapes or types than this fit has.
        """


class Family(NamedTuple):
    """A row of the table of families.

    - `make`: the constructor.
    - `shadings`, `default_shading`: values of the option `shading`.
    - `default_size`: pixels along the longer side of the fit; None: as many as the target has.
    - `min_triangles`: the smallest value of the option `triangles`.
    - `translucent`: whether the option of that name may be true.
    - `unknowns`: the unknowns as a pytree, from their leaves.
    - `check_state`: checks what `own_state` saved, of a fit with given settings, size and number of
      active triangles; returns the shapes of the unknowns, or raises `ValueError`.
    """

    make: Callable[[FitRequest], AbstractFit]
    shadings: tuple[str, ...]
    default_shading: str
    default_size: int | None
    min_triangles: int
    translucent: bool
    unknowns: Callable[[list[Any]], Any]
    check_state: Callable[[Entries, dict[str, Any], Size, int], list[tuple[int, ...]]]
