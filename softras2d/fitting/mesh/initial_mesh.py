"""Make the mesh from which a fit starts, as the option `start` says."""

import numpy as np

from ..family import FitRequest
from . import saved
from .colors import ColorModel
from .early_program import EarlyProgram
from .start import delaunay_start, error_start, uniform_start
from .triangulation import Mesh, check_tiling


def initial_mesh(request: FitRequest, model: ColorModel, early: EarlyProgram) -> Mesh:
    """Make the mesh from which a fit starts, or take it from the state of a fit to be resumed.

    The mesh is in pixels of the fit. Raises `ValueError` for a start that does not suit the fit.

    - `model`: the colour model (see `colors`).
    - `early`: compiles the program of the fit's steps. With `start="error"`, this begins when
      `error_start` calls `has_settled`. While it lasts, the mesh is improved further even if
      `request.must_start` returns true, unless Ctrl-C was pressed.
    """
    target, start, seed = request.target, request.start, request.seed
    height, width = target.image.shape[:2]
    if request.resume_state is not None:
        return _checked(saved.mesh_of(request.resume_state), request)
    if isinstance(start, Mesh):
        return _checked(start, request)
    vertices = saved.max_vertices(request.settings)
    if start == "uniform":
        return uniform_start(height, width, vertices, seed=seed)
    if start == "delaunay":
        return delaunay_start(target, vertices, seed=seed)
    if start != "error":
        raise ValueError(
            f"`start` must be 'error', 'uniform', 'delaunay' or a Mesh; got {start!r:.60}."
        )

    def must_start() -> bool:
        # No step can be taken before the program is compiled, so the start may as well improve,
        # unless no step will be taken at all.
        if request.is_interrupted():
            return True
        return request.must_start() and not early.is_compiling()

    return error_start(
        target, vertices, model=model, seed=seed, must_start=must_start,
        has_settled=early.compile_for,
    )  # fmt: skip


def _checked(mesh: Mesh, request: FitRequest) -> Mesh:
    """Return `mesh` itself; raise `ValueError` unless the fit can start from it.

    It must have the size of the fit, tile the canvas, and have at most `saved.max_vertices`
    vertices.
    """
    height, width = request.target.image.shape[:2]
    if not np.isfinite(mesh.positions).all():
        raise ValueError("`start` is a mesh with a position that is not finite.")
    if (mesh.height, mesh.width) != (height, width):
        raise ValueError(
            f"`start` is a mesh of {mesh.width} x {mesh.height} pixels; the fit has "
            f"{width} x {height}."
        )
    limit = saved.max_vertices(request.settings)
    if len(mesh.positions) > limit:
        raise ValueError(f"`start` has {len(mesh.positions)} vertices; `triangles` allows {limit}.")
    check_tiling(mesh)
    return mesh
