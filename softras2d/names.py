"""The names that a caller may give for each option.

This module imports nothing but `typing`, so that the command line can offer the names without
loading JAX.
"""

from typing import Any, Literal, get_args

CoverageKind = Literal["sampled", "soft", "area"]
FillRule = Literal["inclusive", "top_left"]
Shading = Literal["sample", "pixel"]
SoftProfile = Literal["logistic", "softras", "window"]
AreaCompositing = Literal["over", "sum"]
PixelFilter = Literal["nearest", "bilinear"]
PlanCapacity = Literal["scene", "worst_case"]
OnOverflow = Literal["raise", "nan"]
LevelFilter = Literal["zero", "nearest", "linear"]
TextureBorder = Literal["clamp", "repeat"]
TextureAddressing = Literal["half_texel", "corners"]

SvgDialect = Literal["svg", "course"]
SvgFit = Literal["contain", "cover", "stretch"]
ImageFormat = Literal["png", "exr", "jpg", "tif"]

FitFamily = Literal["layers", "mesh"]
FitShading = Literal["flat", "gouraud", "linear"]
FitStart = Literal["error", "uniform", "delaunay"]
Solver = Literal["adam", "lm", "dogleg", "bfgs", "lbfgs"]
ColorMethod = Literal["together", "solve", "polish"]
Loss = Literal["squared", "l1", "ssim"]
FitBackground = Literal["mean", "fit", "transparent"]
FreezeGroup = Literal["positions", "colors", "opacity", "vertices", "triangles"]
LossSpace = Literal["display", "linear"]


def check_name(argument: str, value: object, names: Any) -> None:
    """Raise `ValueError` unless `value` is one of the names that the type `names` lists.

    - `argument`: name of the caller's argument, for the message.
    - `names`: a `Literal` of this module, such as `FillRule`.
    """
    allowed = get_args(names)
    if value not in allowed:
        listed = ", ".join(map(repr, allowed))
        raise ValueError(f"`{argument}` must be one of {listed}; got {value!r}.")
