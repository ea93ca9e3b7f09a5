"""Which unknowns of layers are frozen, and whether the background has a colour of the palette."""

import numpy as np
from jaxtyping import Float

from ..family import FitRequest
from ..frozen import Mask

_FIELDS = {"positions": "corners", "colors": "colors", "opacity": "opacity"}
"""The field of `LayersUnknowns` that each of these names in the option `freeze` freezes."""


def frozen_fields(request: FitRequest, *, has_fixed_colors: bool) -> dict[str, bool | Mask]:
    """Return which unknowns are frozen, as the argument `masks` of `frozen.freeze`.

    The keys are fields of `LayersUnknowns`. A field that is frozen has the value True; a field of
    which only some triangles are frozen has their mask; other fields are absent.

    `has_fixed_colors`: whether all colours are frozen, because a palette decides them.
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
    """Whether the background must have a colour of the palette.

    It must if there is a palette, and the fit chooses an opaque background itself. The fit does not
    choose a background with alpha, a colour that the user gave, or, unless the option `background`
    is `"fit"`, the background of a scene to start from.

    `background`: the present background.
    """
    setting = request.settings["background"]
    is_given = setting != "fit" and request.starts_from_object
    is_chosen = len(background) == 3 and setting in ("mean", "fit") and not is_given
    return request.settings["palette"] is not None and is_chosen
