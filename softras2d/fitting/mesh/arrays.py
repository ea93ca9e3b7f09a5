"""Make the arrays of a fit from a mesh: the unknowns of the solver, and the data of the residual.

The numbers of vertices and of triangles in the arrays do not change during a fit, so that one
compiled program serves the whole fit. The number of triangles of a mesh changes a little when
vertices are exchanged (see `exchange`). Therefore the arrays of triangles have spare entries.
"""

import numpy as np
from jaxtyping import Array, Float

from ...numerics.device import to_device
from ..family import FitRequest
from ..frozen import freeze
from ..units import POSITION_UNIT
from .colors import ColorModel, Colors, solve_colors
from .steering import free_coordinates, frozen_colors
from .triangulation import Mesh, least_altitudes
from .unknowns import MeshData, MeshUnknowns

_SCALE_PER_ALTITUDE, _MIN_SCALE = 0.3, 0.02
"""Numbers that define the scale of a vertex, `MeshData.scale`.

In units of `POSITION_UNIT`, it is `clip(_SCALE_PER_ALTITUDE * altitude, _MIN_SCALE, 1)`, where
`altitude` is the least altitude of the triangles around the vertex, in pixels of the fit."""


def data_and_unknowns(
    mesh: Mesh,
    request: FitRequest,
    model: ColorModel,
    *,
    has_fixed_colors: bool,
    scale: Float[np.ndarray, "vertices 1"] | None = None,
) -> tuple[MeshData, MeshUnknowns]:
    """Make the data of the residual and the unknowns of the solver, for a fit of `mesh`.

    The unknowns have the positions of the mesh, and the colours of least squared error, clipped to
    0..1. Raises `ValueError` as `steering.frozen_vertices` does.

    - `mesh`: with positions in pixels of the fit.
    - `request`: the request of the fit, with the target, the loss, and what is frozen.
    - `model`: whether there is a colour for each vertex, triangle, or triangle corner.
    - `has_fixed_colors`: whether all colours are frozen, because a palette decides them.
    - `scale`: pixels per unit of position, as in `MeshData.scale`; None: it is computed from the
      altitudes of the triangles.
    """
    target = request.target
    # Euler's formula: 2 V - 2 - b triangles, with b of the V vertices on the border. The number is
    # largest when only the four corners lie there.
    capacity, active = 2 * len(mesh.positions) - 6, len(mesh.triangles)
    triangles = np.zeros((capacity, 3), np.int32)
    triangles[:active] = mesh.triangles
    if scale is None:
        altitudes = least_altitudes(mesh)[:, None]
        scale = POSITION_UNIT * np.clip(_SCALE_PER_ALTITUDE * altitudes, _MIN_SCALE, 1.0)
    data = MeshData(
        request.loss.prepare(to_device(target.image, np.float32)),
        None if target.weights is None else to_device(target.weights, np.float32),
        to_device(np.zeros(3, np.float32)),
        to_device(triangles),
        to_device(free_coordinates(mesh, request)),
        to_device(mesh.positions, np.float32),
        to_device(scale, np.float32),
    )
    colors = np.clip(solve_colors(mesh, target, model=model), 0, 1)
    positions = to_device(mesh.positions / scale, np.float32)
    y = MeshUnknowns(positions, padded_colors(colors, model, capacity))
    if request.may_freeze:
        masks = frozen_colors(mesh, request, model, has_fixed_colors=has_fixed_colors)
        data = data._replace(frozen=freeze(y, masks))
    return data, y


def padded_colors(colors: Colors, model: ColorModel, capacity: int) -> Float[Array, "..."]:
    """Convert colours, as `solve_colors` returns them, to the unknowns `MeshUnknowns.colors`.

    The result is float32. For the colour model `"vertex"` it has the shape of `colors`. Otherwise
    it is `[capacity, 1, channels]` for `"triangle"` and `[capacity, 3, channels]` for `"linear"`,
    with zeros for the spare triangles.

    `capacity`: number of triangles in the arrays, including spare triangles, which are not visible.
    """
    if model != "vertex":
        colors = colors[:, None] if colors.ndim == 2 else colors
        padding = np.zeros((capacity - len(colors), *colors.shape[1:]))
        colors = np.concatenate([colors, padding])
    return to_device(colors, np.float32)
