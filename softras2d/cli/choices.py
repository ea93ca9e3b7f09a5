"""The names that options of the command line accept, one list for each option.

Typer reads the choices from these types, so they are spelled out here, where nothing heavy is
imported.
"""

from typing import Literal

Dialect = Literal["svg", "course"]
FillRule = Literal["inclusive", "top_left"]
RenderShading = Literal["sample", "pixel"]
PixelFilter = Literal["bilinear", "nearest"]
LevelFilter = Literal["linear", "nearest", "zero"]
ImageFormat = Literal["png", "exr", "jpg", "tif"]

FitFamily = Literal["layers", "mesh"]
FitShading = Literal["flat", "gouraud", "linear"]
Solver = Literal["adam", "lm", "dogleg", "bfgs", "lbfgs"]
ColorMethod = Literal["together", "solve", "polish"]
Loss = Literal["squared", "l1", "ssim"]
LossSpace = Literal["display", "linear"]
Start = Literal["error", "uniform", "delaunay"]
"""Names that `--start` accepts besides a file."""
