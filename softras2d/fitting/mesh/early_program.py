"""Compile the program of a fit's steps while the host still improves the start of the fit.

The search for a start runs on one core for several seconds, and so does the compiler. The program
is compiled for an intermediate mesh of the search. The final mesh costs about as much to draw, and
has arrays of the same shapes.

The program is compiled again if a later exchange of vertices (see `exchange`) leaves the mesh with
fewer vertices, or if the mesh outgrows the plan, which fixes the sizes of the arrays with which it
is drawn. It is also compiled again if the caller has changed settings of JAX for its thread alone,
as by `jax.default_device`: another thread does not see them.
"""

from concurrent.futures import Future, ThreadPoolExecutor

import jax

from ..family import FitRequest
from ..solve import advance, begin
from .arrays import data_and_unknowns
from .colors import ColorModel
from .triangulation import Mesh
from .unknowns import MeshResidual, mesh_plan, mesh_scene


class EarlyProgram:
    """Compiles, in another thread, the program that takes the steps of a fit.

    It is compiled while the search for the fit's initial mesh goes on, for the mesh of that moment.

    - `request`: the request of the fit. Nothing is compiled early if its `early_chunk_steps` is
      None.
    - `model`: the colour model of the fit.
    """

    def __init__(self, request: FitRequest, model: ColorModel):
        self._request = request
        self._model: ColorModel = model
        self._residual: Future[MeshResidual] | None = None

    def compile_for(self, mesh: Mesh) -> None:
        """Begin to compile the program for a mesh in another thread, and return at once.

        Does nothing if `early_chunk_steps` of the request is None. Python does not exit before the
        thread has ended, because XLA must not be ended while it compiles.
        """
        if self._request.early_chunk_steps is not None:
            pool = ThreadPoolExecutor(1)
            self._residual = pool.submit(self._compile, mesh)
            pool.shutdown(wait=False)

    def is_compiling(self) -> bool:
        """Whether the program is being compiled now, so that the fit cannot take steps yet."""
        return self._residual is not None and not self._residual.done()

    def residual(self) -> MeshResidual | None:
        """Wait for the program, and return the residual for which it was compiled.

        Returns None if no compilation was begun. After Ctrl-C no step will be taken, so the method
        does not wait, and returns None if the program is not compiled yet. Raises the error of the
        other thread if the compilation failed.

        The final mesh may need more capacity than the residual's plan has. The plan is then
        replaced at the first chunk of steps, as at any other (`chunk.advance_fits`).
        """
        if self._residual is None or (self._request.is_interrupted() and self.is_compiling()):
            return None
        return self._residual.result()

    def _compile(self, mesh: Mesh) -> MeshResidual:
        """Compile the programs that begin a solve and take its steps, for the size of `mesh`.

        Returns the residual that these programs minimise.
        """
        request = self._request
        with jax.enable_x64(False):
            data, y = data_and_unknowns(mesh, request, self._model, has_fixed_colors=False)
            plan = mesh_plan([mesh_scene(y, data)], request.target.image)
            residual = MeshResidual(plan, request.loss)
            progress = begin(request.solver, residual, y, data)
            # No step is taken, but the program is compiled as for a chunk of steps.
            advance(
                request.solver, residual, progress, data,
                steps=0, max_steps=request.early_chunk_steps,
            )  # fmt: skip
        return residual
