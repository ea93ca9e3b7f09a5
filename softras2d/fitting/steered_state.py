"""Write and check the entries of a saved fit that has a palette, or unknowns that are frozen."""

from typing import Any

import numpy as np
from jaxtyping import Float

from .entries import Entries
from .frozen import Frozen
from .steering import MASKED
from .trees import tree_arrays


def steered_state(
    palette: Float[np.ndarray, "colors 3"] | None, is_quantized: bool, frozen: Frozen | None
) -> dict[str, np.ndarray]:
    """Make the entries, which are arrays by name; none if both `palette` and `frozen` are None.

    - `palette`: RGB in 0..1.
    - `quantized`: `is_quantized`, whether the triangles have colours of the palette by now.
    - `frozen.0`, ...: the arrays of `frozen.values`, in the order of `jax.tree.leaves`.

    `task.Task` adds `freeze.vertices` and `freeze.triangles`, the masks that the user gave.
    """
    arrays: dict[str, np.ndarray] = {}
    if palette is not None:
        arrays |= {"palette": palette, "quantized": np.array(is_quantized)}
    return arrays if frozen is None else arrays | tree_arrays("frozen", frozen.values)


def check_steered_state(
    entries: Entries, settings: dict[str, Any], shapes: list[tuple[int, ...]]
) -> None:
    """Check the entries that `steered_state` made; raise `ValueError` for a fault.

    `shapes`: the shapes of the leaves of the unknowns.
    """
    palette, groups = settings["palette"], settings["freeze"]
    if palette is not None:
        count = palette if isinstance(palette, int) else len(palette)
        entries.finite("palette", np.float32, (count, 3), low=0.0, high=1.0)
        entries.take("quantized", bool, ())
    for group in MASKED:
        if group in groups:
            entries.take(f"freeze.{group}", bool, (group,))
    if palette is not None or groups:
        for number, shape in enumerate(shapes):
            entries.finite(f"frozen.{number}", np.float32, shape)
