"""Save, read and check the arrays of a saved fit that only layers have."""

import json
from typing import Any

import numpy as np

from ...planning.size_classes import unknowns_class
from ..entries import TINY, Entries, Size, read_json
from ..trees import fill_tree, tree_arrays
from .unknowns import LayersUnknowns


def pack(
    best: tuple[float, LayersUnknowns] | None,
    overshoot: float,
    width: Any,
    background: np.ndarray,
    rng: np.random.Generator,
) -> dict[str, np.ndarray]:
    """Return the arrays, by name, that are saved for a fit of layers only.

    - `best`: the least loss before triangles were last added or replaced, and its unknowns, or
      None. They are saved as the arrays `kept` and `kept.0`, `kept.1`, ..., which are absent for
      None.
    - `overshoot`: how far corners may lie outside the canvas, as in `canvas.near_canvas`. It is
      saved as the array `beyond`.
    - `width`: the width of soft edges, in pixels of the fit, saved as the array `width`.
    - `background`: the background, with straight alpha, saved as the array `background`.
    - `rng`: the random generator, whose state is saved as JSON in the array `random`.
    """
    arrays: dict[str, np.ndarray] = {}
    if best is not None:
        loss, y = best
        arrays["kept"] = np.array(loss)
        arrays |= tree_arrays("kept", y)
    arrays["beyond"] = np.array(overshoot)
    arrays["width"] = np.asarray(width)
    arrays["background"] = np.asarray(background)
    generator = json.dumps(rng.bit_generator.state).encode()
    arrays["random"] = np.frombuffer(generator, np.uint8)
    return arrays


def unpack_best(
    y: LayersUnknowns, arrays: dict[str, np.ndarray]
) -> tuple[float, LayersUnknowns] | None:
    """Return the loss and unknowns that `pack` got as `best`; None if it got None.

    - `y`: unknowns with the shapes and types that the saved ones must have.
    - `arrays`: all arrays of the saved state, by name.

    Raises `ValueError` for another shape or type.
    """
    if "kept" not in arrays:
        return None
    return float(arrays["kept"]), fill_tree(y, "kept", arrays)


def restore_generator(rng: np.random.Generator, arrays: dict[str, np.ndarray]) -> None:
    """Set the state of `rng` to the saved one, the array `random` among the arrays of a fit."""
    rng.bit_generator.state = json.loads(arrays["random"].tobytes().decode())


def length_of(arrays: dict[str, Any]) -> int:
    """Number of triangles in the arrays of a saved fit of layers, including those not in use yet.

    `arrays`: all arrays of the saved state, by name.
    """
    return len(arrays["solve.0"])


def check_layers_state(
    entries: Entries, settings: dict[str, Any], size: Size, active: int
) -> list[tuple[int, ...]]:
    """Check the arrays that `pack` returned; raise `ValueError` for a fault.

    Returns the shapes of the arrays of `LayersUnknowns`, in order, without that of absent
    opacities.

    - `entries`: the arrays of the saved fit. Those that are checked are removed.
    - `settings`, `size`: the settings and the size of the fit.
    - `active`: number of triangles in use, which is not needed here.
    """
    corners = 1 if settings["shading"] == "flat" else 3
    count = settings["triangles"]
    # In early files the arrays have this length; in later ones it is rounded up to a size class.
    if entries.length("solve.0") != count:
        count = unknowns_class(count)
    shapes: list[tuple[int, ...]] = [(count, 3, 2), (count, corners, 3)]
    shapes += [(count,)] if settings["translucent"] else []
    entries.finite("beyond", np.float64, (), low=0.0)
    entries.finite("width", np.float32, (), low=TINY, high=64.0)
    background = entries.finite("background", np.float32, (size.channels,))
    if not ((background[3:] >= 0) & (background[3:] <= 1)).all():
        name = entries.full_name("background")
        raise ValueError(f"the alpha of `{name}` must be in 0..1; got {background[3]}.")
    random = entries.full_name("random")
    generator = read_json(random, entries.take("random", np.uint8, ("bytes",)))
    try:
        np.random.default_rng(0).bit_generator.state = generator
    except Exception:
        # NumPy raises exceptions of many types, depending on the fault.
        raise ValueError(f"`{random}` must be the state of a PCG64 generator.") from None
    if "kept" in entries:
        entries.finite("kept", np.float64, (), low=0.0)
        for number, shape in enumerate(shapes):
            entries.finite(f"kept.{number}", np.float32, shape)
    return shapes
