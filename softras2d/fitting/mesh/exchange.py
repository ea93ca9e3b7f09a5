"""Move vertices to where the error is large: collapse some, and insert as many elsewhere."""

from ..target import Target
from .collapse import collapse
from .colors import ColorModel
from .edge_flips import flip_edges
from .insertion import insert
from .triangulation import Mesh


def exchange(mesh: Mesh, target: Target, count: int, *, model: ColorModel = "vertex") -> Mesh:
    """Collapse up to `count` vertices, insert as many elsewhere, and then flip edges in one round.

    The collapsed vertices are those whose removal raises the squared error least. The new vertices
    are inserted where they lower it most. If fewer can be inserted, the returned mesh has fewer
    vertices than `mesh`.

    - `mesh`, `target`: in pixels of the fit.
    - `model`: the colour model (see `colors`) for which the squared error is computed.
    """
    vertices = len(mesh.positions)
    mesh = collapse(mesh, target, count, model=model)
    mesh = insert(mesh, target, vertices - len(mesh.positions), model=model)
    return flip_edges(mesh, target, model=model, rounds=1)
