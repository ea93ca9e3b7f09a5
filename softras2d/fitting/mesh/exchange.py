"""Move vertices to where the error is large: collapse some, and then insert as many."""

from ..target import Target
from .collapse import collapse
from .colors import ColorModel
from .edge_flips import flip_edges
from .insertion import insert
from .triangulation import Mesh


def exchange(mesh: Mesh, target: Target, count: int, *, model: ColorModel = "vertex") -> Mesh:
    """Remove up to `count` vertices, insert as many, and flip edges in one round; return the mesh.

    `collapse` removes vertices whose removal raises the squared error least. `insert` adds vertices
    where they lower it most. `flip_edges` flips edges where that lowers it. If fewer vertices can
    be inserted than were removed, the returned mesh has fewer vertices than `mesh`.

    - `mesh`, `target`: in pixels of the fit.
    - `model`: the colour model (see `colors`) for which the squared error is computed.
    """
    vertices = len(mesh.positions)
    mesh = collapse(mesh, target, count, model=model)
    mesh = insert(mesh, target, vertices - len(mesh.positions), model=model)
    return flip_edges(mesh, target, model=model, rounds=1)
