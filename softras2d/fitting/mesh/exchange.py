"""Exchange vertices of a mesh: collapse some, and insert as many elsewhere."""

from ..target import Target
from .collapse import collapse
from .colors import ColorModel
from .edge_flips import flip_edges
from .insertion import insert
from .triangulation import Mesh


def exchange(mesh: Mesh, target: Target, count: int, *, model: ColorModel = "vertex") -> Mesh:
    """Collapse up to `count` vertices, insert as many elsewhere, and flip edges once.

    The collapsed vertices are those whose removal raises the error least; the new ones are inserted
    where they lower it most. The mesh has fewer vertices if fewer can be inserted.
    """
    vertices = len(mesh.positions)
    mesh = collapse(mesh, target, count, model=model)
    mesh = insert(mesh, target, vertices - len(mesh.positions), model=model)
    return flip_edges(mesh, target, model=model, rounds=1)
