"""The table of fit families, by the name that the option `family` accepts.

`traits` has a table of the option values that each family accepts, which loads without JAX.
"""

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
        unknowns=layers_of,
        check_state=check_layers_state,
    ),
    "mesh": Family(
        make=MeshFit,
        unknowns=lambda leaves: MeshUnknowns(*leaves),
        check_state=check_mesh_state,
    ),
}
