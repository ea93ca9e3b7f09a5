"""What the options `freeze`, `palette` and `background` decide in a fit of layers."""

import numpy as np
from jaxtyping import Float

from ..family import FitRequest
from ..frozen import Mask

_FIELDS = {"positions": "corners", "colors": "colors", "opacity": "opacity"}
"""For each name in the option `freeze` that freezes a whole field of the unknowns, that field."""


def frozen_fields(request: FitRequest, *, has_fixed_colors: bool) -> dict[str, bool | Mask]:
    """Return which unknowns are frozen, by field of `LayersUnknowns`, as `frozen.freeze` takes it.

    A frozen field has True, and a field in which some triangles are frozen has their mask.
    `has_fixed_colors`: whether all colours are frozen, because the palette decides them.
    """
    groups, triangles = request.settings["freeze"], request.masks.get("triangles")
    fields: dict[str, bool | Mask] = {}
    for group, field in _FIELDS.items():
        if group in groups or (field == "colors" and has_fixed_colors):
            fields[field] = True
        elif triangles is not None:
            fields[field] = triangles
    return fields


def has_palette_background(request: FitRequest, background: Float[np.ndarray, " channels"]) -> bool:
    """Whether the background gets a colour of the palette.

    It does if there is a palette and the fit chooses the background. A colour that the user gave,
    the background of a scene to start from, and a transparent background stay as they are.
    `background`: the present one.
    """
    setting = request.settings["background"]
    is_given = setting != "fit" and request.starts_from_object
    is_chosen = len(background) == 3 and setting in ("mean", "fit") and not is_given
    return request.settings["palette"] is not None and is_chosen
