"""Save and check the arrays of a fit that has a palette or frozen unknowns."""

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
    """Return the arrays to be saved, by name, for a palette and frozen unknowns.

    - `palette`: the palette, RGB in 0..1; None if there is none. It is saved as the array
      `palette`.
    - `is_quantized`: whether the triangles have colours of the palette by now. It is saved with the
      palette, as the array `quantized`.
    - `frozen`: the frozen unknowns; None if there are none. The leaves of `frozen.values` are saved
      as the arrays `frozen.0`, `frozen.1`, ..., in the order of `jax.tree.leaves`.

    The masks that the user gave are saved by `task.Task`, as `freeze.vertices` and
    `freeze.triangles`.
    """
    arrays: dict[str, np.ndarray] = {}
    if palette is not None:
        arrays |= {"palette": palette, "quantized": np.array(is_quantized)}
    return arrays if frozen is None else arrays | tree_arrays("frozen", frozen.values)


def check_steered_state(
    entries: Entries, settings: dict[str, Any], shapes: list[tuple[int, ...]]
) -> None:
    """Check the arrays that `steered_state` returned, and the masks of the option `freeze`.

    Raises `ValueError` for a wrong type, shape or range. A mask may have any length.

    - `entries`: the arrays of the saved fit. Those that are checked are removed.
    - `settings`: the settings of the saved fit.
    - `shapes`: the shapes of the leaves of the unknowns.
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
