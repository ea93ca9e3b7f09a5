"""The interface of a fit family. The families are layers, which are free triangles, and meshes.

A fit alternates between two kinds of work. A *chunk* of solver steps runs as one compiled program
and changes only the *unknowns*: positions, colours and perhaps opacities. Between chunks, the
family does on the host what a solver cannot do: it adds triangles, moves triangles to where the
error is, or repairs a mesh. `chunk.py` runs the chunks, and calls `replan` if a scene has outgrown
its plan. `loop.run` calls `refine` between chunks. `task.Task` calls the other methods: at the
start, at the end, for a user's `callback`, and to save and restore.

To add a family, write a subclass of `AbstractFit`, and add a row to `traits.TRAITS` and to
`families.FAMILIES`.
"""

import abc
from collections.abc import Callable, Mapping, Sequence
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
    """Everything that a family needs to construct a fit before its first step.

    - `target`: the image and its weights, at the size of the fit.
    - `settings`: the arguments of `fit`, checked and completed by `choices`.
    - `start`: a name that the option `start` accepts, or a `Scene` or `Mesh` in pixels of the fit.
      It is `choices.FROM_OBJECT` in a resumed fit that once started from a scene or a mesh.
    - `loss`: the error to be minimised.
    - `solver`: the optimizer.
    - `seed`: the seed of all random choices.
    - `adjustable_rate`: whether the solver has a learning rate that the family may lower.
    - `resume_state`: the saved arrays of the fit to be resumed, by name, or None for a new fit. The
      constructor reads from them only what fixes the shapes of the fit (for a mesh, the mesh
      itself); `AbstractFit.restore_family_state` restores the other values later.
    - `must_start()`: returns whether the search for initial triangles should end with the triangles
      that it has, because its time is up or Ctrl-C was pressed. If only its time is up, the search
      may go on until the program of the fit's steps is compiled.
    - `is_interrupted()`: returns whether Ctrl-C was pressed. No step will then be taken.
    - `early_chunk_steps`: the largest number of steps of a chunk. A family may compile the program
      for it while it still makes the initial triangles. None if it must not do so, because the fit
      is advanced together with others.
    - `masks`: the boolean masks of the option `freeze`, by the names `"vertices"` and
      `"triangles"`, true where frozen. A name that the user did not give is absent.
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
    is_interrupted: Callable[[], bool]
    early_chunk_steps: int | None
    masks: Mapping[str, Mask]

    @property
    def exchanges(self) -> bool:
        """Whether, between chunks of steps, some triangles or vertices are replaced by new ones.

        The new ones lie where the error is large. The answer is true for `start="error"`, unless
        the option `freeze` names anything.
        """
        return self.places_by_error and not self.settings["freeze"]

    @property
    def places_by_error(self) -> bool:
        """Whether the fit adds new triangles or vertices where the error is large.

        This is so for `start="error"`.
        """
        return self.settings["start"] == "error"

    @property
    def may_freeze(self) -> bool:
        """Whether some unknowns are frozen, now or later: `freeze` or `palette` has been given."""
        return bool(self.settings["freeze"]) or self.settings["palette"] is not None

    @property
    def starts_from_object(self) -> bool:
        """Whether the user gave a scene or a mesh as the option `start`.

        In a resumed fit, the option of the earlier fit counts. The answer is also true after
        `LayersFit.retarget`, which continues with another target from the triangles so far.
        """
        start = self.settings["start"]
        return not isinstance(start, str) or start not in get_args(names.FitStart)

    @property
    def finds_palette(self) -> bool:
        """Whether the fit chooses the palette, because the user gave only its number of colours."""
        return isinstance(self.settings["palette"], int)

    @property
    def solves_colors(self) -> bool:
        """Whether the colours of least squared error are solved for before each chunk of steps."""
        return self.settings["colors"] == "solve"


class AbstractFit(abc.ABC):
    """The state of one fit between two chunks of steps, and what its family does at that time.

    The constructor of a family takes a `FitRequest`, makes the initial triangles, plans how to draw
    them (see `planning.plan`) and sets all of the attributes below. It raises `ValueError` for a
    request that does not suit the family, such as a start of the wrong type.

    - `request`: the request from which the fit was made.
    - `residual`: the function that the solver minimises. `residual(unknowns, data)` returns `(out,
      (image, outgrown))`. `out` is the residual of least squares, or the scalar loss; `image` is
      the image of these unknowns, with straight alpha; and `outgrown` says whether their scene
      needs more capacity than the plan has, so that triangles are missing in the image.
    - `data`: the arrays besides the unknowns on which the residual depends. They may change between
      chunks without compiling again.
    - `progress`: the unknowns, the solver's state and the number of steps.
    - `image`: the image of the last step, with straight alpha, at the size and with the coverage of
      the fit. Before the first step it is the background (layers) or the target (mesh).
    - `active`: number of triangles in use. They come first in the arrays; the other triangles are
      spare, and are not visible.
    - `last_exchange`: share of the fit that was done, 0..1, at the last exchange of triangles or
      vertices for new ones, even if none could be exchanged then; 0 if there was no exchange.
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
        """Largest number of triangles in use at the end of the fit; for a mesh, an estimate."""

    @abc.abstractmethod
    def likely_scene(self) -> Scene:
        """Make a scene, in pixels of the fit, about as costly to draw as the scenes of later steps.

        Plans get capacity for this scene, and programs are compiled for its shapes.
        """

    @abc.abstractmethod
    def scene(self, *, padded: bool = False) -> Scene:
        """The scene with the least loss so far, in pixels of the fit.

        It is the scene of the present unknowns if no loss is known yet. Unknowns that were best
        before the loss itself changed, as by sharper soft edges, do not count. If the fit has a
        palette, all triangles have colours of the palette.

        `padded`: keep the spare triangles, which are not visible, so that all scenes of a fit have
        the same shapes and share a compiled program.
        """

    @abc.abstractmethod
    def current_scene(self) -> Scene:
        """The scene of the present unknowns, in pixels of the fit, with the triangles in use alone.

        If the fit has a palette, all triangles have colours of the palette.
        """

    @abc.abstractmethod
    def go_on_from(self, scene: Scene) -> None:
        """Continue from a scene, and forget the best unknowns so far.

        `scene` is in pixels of the fit, and has the triangles of `current_scene`, with other
        positions, colours or background. Frozen unknowns keep their values. If the triangles
        already have colours of a palette, each colour is replaced by the nearest colour of the
        palette. The vertices of a mesh move only as far as no triangle is flipped.
        """

    @abc.abstractmethod
    def replan(self, reached: Sequence[tuple[Any, Any]]) -> Residual:
        """Return a residual whose plan has capacity for the scenes of all unknowns in `reached`.

        A plan fixes the sizes of the arrays with which scenes are drawn. The fit itself does not
        change.

        `reached`: pairs `(unknowns, data)`. The data may come from another fit of the same batch,
        whose frozen values and background differ.
        """

    @abc.abstractmethod
    def refine(self, share: float) -> None:
        """Improve the fit on the host before a chunk of steps, as by adding or moving triangles.

        `progress` and `data` may change, but not the shapes of their arrays, so that the compiled
        program can be used again.

        With the option `palette`, once `share` has reached `palette.PALETTE_START`, this method
        also assigns a colour of the palette to each triangle (`palette.quantize`), and freezes the
        colours for the chunk (`frozen.Frozen`). Before that, the solver changes colours freely, and
        `scene` and `current_scene` replace each colour by the nearest colour of the palette.

        `share`: share of the fit that is done, 0..1.
        """

    @abc.abstractmethod
    def polish(self) -> None:
        """Replace the unknowns by the best so far, with the colours of least squared error.

        The squared error is weighted, and summed over pixels and channels, at the size of the fit
        and in the colour space of the loss. `residual` is replaced, too, if its plan is too small
        for these unknowns. Afterwards `scene` returns the scene of these unknowns.
        """

    def polish_at_full_size(self, target: Target) -> None:  # noqa: B027
        """Replace the unknowns by the best so far, with colours that suit the full-size target.

        It is called at the end of a fit that is smaller than its target. `target`: the image and
        its weights at their original size. The method does nothing unless a family overrides it.
        """

    @abc.abstractmethod
    def family_state(self) -> dict[str, np.ndarray]:
        """Return the arrays, by name, that are saved for a fit of this family only.

        `state.save_state` adds them to the arrays that it saves for all families. The names are
        part of the file format.
        """

    @abc.abstractmethod
    def restore_family_state(self, arrays: dict[str, np.ndarray]) -> None:
        """Restore what `family_state` returned; `state.restore_state` has restored everything else.

        `arrays` has all arrays of the saved state, by name, which `saved_fit.check_state` has
        checked. Raises `ValueError` for unknowns of other shapes or types than this fit has.
        """


class Family(NamedTuple):
    """A row of the table of fit families, `families.FAMILIES`.

    - `make`: the constructor of the family's fit.
    - `unknowns`: function that makes the pytree of unknowns from its leaves, in the order of
      `jax.tree.leaves`.
    - `check_state`: function of the saved arrays, and of the fit's settings, size and number of
      triangles in use. It checks the arrays that `family_state` returned, except those of
      `steered_state`, and raises `ValueError` if one is invalid. It returns the shapes of the
      leaves of the unknowns.
    """

    make: Callable[[FitRequest], AbstractFit]
    unknowns: Callable[[list[Any]], Any]
    check_state: Callable[[Entries, dict[str, Any], Size, int], list[tuple[int, ...]]]
