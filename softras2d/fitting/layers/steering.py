"""What the options `freeze`, `palette` and `background` decide in a fit of layers."""

import numpy as np
from jaxtyping import Float

from ..family import FitRequest
from ..frozen import Mask

_FIELDS = {"positions": "corners", "colors": "colors", "opacity": "opacity"}
"""The field of the unknowns for each group of the option `freeze` that is frozen as a whole."""


def frozen_fields(request: FitRequest, *, has_fixed_colors: bool) -> dict[str, bool | Mask]:
    """Fields of the unknowns that are frozen: True for a whole field, or the frozen triangles.

    `has_fixed_colors`: whether the palette decides the colours, so that the solver must not.
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
    """Whether the background has a colour of the palette, too.

    It has if the fit chooses it. A colour that the user gave, that of a scene to start from, and a
    transparent background stay as they are.
    """
    setting = request.settings["background"]
    is_given = setting != "fit" and request.starts_from_object
    is_chosen = len(background) == 3 and setting in ("mean", "fit") and not is_given
    return request.settings["palette"] is not None and is_chosen
