"""The table of fit families, by the values of the option `family`."""

from .family import Family
from .layers.family import LayersFit
from .layers.saved import check_layers_state
from .layers.unknowns import layers_of
from .mesh.family import MeshFit
from .mesh.saved import check_mesh_state
from .mesh.unknowns import MeshUnknowns

FAMILIES: dict[str, Family] = {
    "layers": Family(
        make=LayersFit,
        shadings=("flat", "gouraud"),
        default_shading="flat",
        default_size=256,
        min_triangles=1,
        translucent=True,
        unknowns=layers_of,
        check_state=check_layers_state,
    ),
    "mesh": Family(
        make=MeshFit,
        shadings=("flat", "gouraud", "linear"),
        default_shading="gouraud",
        default_size=None,
        min_triangles=2,
        translucent=False,
        unknowns=lambda leaves: MeshUnknowns(*leaves),
        check_state=check_mesh_state,
    ),
}
