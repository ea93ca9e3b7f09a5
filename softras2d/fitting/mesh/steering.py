"""Find which positions and colours of a mesh must not change, because of `freeze` or `palette`."""

import numpy as np
from jaxtyping import Bool

from ..family import FitRequest
from ..frozen import Mask
from ..steering import check_length
from .colors import ColorModel
from .triangulation import Mesh, is_bound


def free_coordinates(mesh: Mesh, request: FitRequest) -> Bool[np.ndarray, "vertices 2"]:
    """Whether each coordinate, x and y, of each vertex may move.

    A coordinate may move unless the user froze all positions or the vertex, or the vertex lies on a
    side of the canvas that fixes this coordinate. Raises `ValueError` as `frozen_vertices` does,
    unless all positions are frozen.
    """
    if "positions" in request.settings["freeze"]:
        return np.zeros((len(mesh.positions), 2), bool)
    return ~is_bound(mesh) & ~frozen_vertices(mesh, request)[:, None]


def frozen_colors(
    mesh: Mesh, request: FitRequest, model: ColorModel, *, has_fixed_colors: bool
) -> dict[str, bool | Mask]:
    """Return which colours are frozen, as the argument `masks` of `frozen.freeze`.

    The result has at most one entry, `"colors"`:

    - True if all colours are frozen;
    - otherwise, for the colour model `"vertex"`, the mask of vertices that `frozen_vertices`
      returns, which may raise `ValueError`;
    - otherwise, for the other models, the user's mask of triangles. If the user gave none, there is
      no entry.

    Masks are true where frozen. Frozen positions have no entry, because `MeshData.free` keeps them
    from moving.

    `has_fixed_colors`: whether all colours are frozen, because a palette decides them.
    """
    if "colors" in request.settings["freeze"] or has_fixed_colors:
        return {"colors": True}
    if model != "vertex":
        triangles = request.masks.get("triangles")
        return {} if triangles is None else {"colors": triangles}
    return {"colors": frozen_vertices(mesh, request)}


def frozen_vertices(mesh: Mesh, request: FitRequest) -> Mask:
    """Whether the user froze each vertex, either itself or as a corner of a frozen triangle.

    Only the masks of the option `freeze` count. The name `"positions"`, by which it freezes all
    positions, does not. Raises `ValueError` if a mask does not have one entry for each vertex or
    triangle of `mesh`.
    """
    count, masks = len(mesh.positions), request.masks
    frozen = masks.get("vertices", np.zeros(count, bool)).copy()
    check_length("vertices", frozen, count)
    if "triangles" in masks:
        check_length("triangles", masks["triangles"], len(mesh.triangles))
        frozen[mesh.triangles[masks["triangles"]]] = True
    return frozen
