"""Save, read and check the arrays that only a saved fit of a mesh has."""

from typing import Any

import numpy as np

from ..entries import TINY, Entries, Size
from .triangulation import Mesh, check_tiling


def max_vertices(settings: dict[str, Any]) -> int:
    """Largest number of vertices with which no mesh has more triangles than the settings allow.

    A mesh of v vertices has 2 v - 6 triangles if only four lie on its border, and fewer if more do.
    Four vertices, and so two triangles, are always allowed. `settings`: the arguments of `fit`, of
    which `triangles` counts.
    """
    return max(4, (settings["triangles"] + 6) // 2)


def mesh_arrays(name: str, mesh: Mesh) -> dict[str, np.ndarray]:
    """Return the arrays of a mesh by the names `name.positions`, `name.triangles`, etc.

    `name` is the given prefix, and the part after the dot is a field of `Mesh`.
    """
    return {f"{name}.{field}": value for field, value in mesh._asdict().items()}


def mesh_of(arrays: dict[str, np.ndarray], name: str = "mesh") -> Mesh:
    """Make the mesh whose arrays `mesh_arrays` saved under `name`; the mesh is not checked."""
    return Mesh(*(arrays[f"{name}.{field}"] for field in Mesh._fields))


def check_mesh_state(
    entries: Entries, settings: dict[str, Any], size: Size, active: int
) -> list[tuple[int, ...]]:
    """Check the arrays that `MeshFit.family_state` returned; raise `ValueError` for a fault.

    The arrays of `steered_state`, for a palette and frozen colours, are not checked. Returns the
    shapes of the two arrays of `MeshUnknowns`, `positions` and `colors`.

    - `entries`: the arrays of the saved fit. Those that are checked are removed.
    - `settings`, `size`: the settings and the size of the fit.
    - `active`: number of triangles in use, which the mesh must have.
    """
    limit = max_vertices(settings)
    vertices = _check_mesh(entries, "mesh", size, limit, active)
    shapes = _shapes(settings["shading"], vertices)
    entries.finite("scale", np.float32, (vertices, 1), low=TINY)
    if "kept" in entries:
        entries.finite("kept", np.float64, (), low=0.0)
        best_vertices = _check_mesh(entries, "kept.mesh", size, limit, None)
        entries.finite("kept.scale", np.float32, (best_vertices, 1), low=TINY)
        for number, shape in enumerate(_shapes(settings["shading"], best_vertices)):
            entries.finite(f"kept.{number}", np.float32, shape)
    return shapes


def _shapes(shading: str, vertices: int) -> list[tuple[int, ...]]:
    """Shapes of the unknowns, positions and colours, of a mesh with `vertices` vertices.

    `shading`: the value of the option `shading`. With `"gouraud"`, there is one colour per vertex;
    otherwise, 2 `vertices` - 6 triangles have one (`"flat"`) or three colours each.
    """
    if shading == "gouraud":
        return [(vertices, 2), (vertices, 3)]
    return [(vertices, 2), (2 * vertices - 6, 1 if shading == "flat" else 3, 3)]


def _check_mesh(entries: Entries, name: str, size: Size, limit: int, active: int | None) -> int:
    """Check that a saved mesh tiles the canvas, else raise `ValueError`; return its vertex count.

    - `entries`: the arrays of the saved fit. Those of the mesh are removed.
    - `name`: the prefix of the names of these arrays, as in `mesh_arrays`.
    - `size`: size of the fit, which is the canvas.
    - `limit`: the largest allowed number of vertices.
    - `active`: the required number of triangles; None allows any.
    """
    full = entries.full_name(name)
    positions = entries.finite(f"{name}.positions", np.float64, ("vertices", 2))
    count = len(positions)
    if not 4 <= count <= limit:
        raise ValueError(f"`{full}.positions` must be 4 to {limit} vertices; got {count}.")
    triangles = entries.take(
        f"{name}.triangles", np.int32, ("triangles" if active is None else active, 3)
    )
    if not ((triangles >= 0) & (triangles < count)).all() or len(triangles) > 2 * count - 6:
        raise ValueError(
            f"`{full}.triangles` must be {2 * count - 6} at most, of vertices in 0..{count - 1}."
        )
    free = [entries.take(f"{name}.{axis}", bool, (count,)) for axis in ("free_x", "free_y")]
    mesh = Mesh(positions, triangles, *free)
    if (positions < 0).any() or (positions.max(0) != [size.width, size.height]).any():
        raise ValueError(f"`{full}` must cover the fit, {size.width} x {size.height} pixels.")
    try:
        check_tiling(mesh)
    except ValueError as error:
        raise ValueError(f"`{full}` must tile the canvas: {error}") from None
    return count
