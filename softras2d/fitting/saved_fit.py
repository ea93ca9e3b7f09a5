"""What a saved fit must hold: the type, shape and range of every entry, and that they agree.

Files come from anywhere, so nothing of them is used before it has been looked at here. Each fault
is one `ValueError` that names the entry and what was expected of it.
"""

import json
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from ..numerics.device import to_device
from ..planning.size_classes import fine_class
from ..scene import Scene, check
from . import choices
from .frame import Frame
from .layers.unknowns import Layers
from .mesh.triangulation import Mesh, check_tiling
from .mesh.unknowns import Tiling
from .solve import begin
from .solvers import SOLVERS, solver_of

FORMAT = 3

SCENE = ("positions", "triangles", "colors", "background")
"""Fields of a fitted scene."""

_SETTINGS = (
    "triangles", "family", "solver", "seed", "size", "shading", "translucent", "softness",
    "colors", "loss", "light", "start",
)  # fmt: skip

_LONGEST_FACTS = 2**20
"""Bytes of JSON."""

_MAX_SIDE = 2**16
"""Pixels along a side of an image that is read."""


_TINY = float(np.finfo(np.float32).tiny)


class Size(NamedTuple):
    """Of an image: pixels and channels."""

    height: int
    width: int
    channels: int


class Entries:
    """Arrays by name, each taken once; what is left at the end is no part of a fit."""

    def __init__(self, arrays: dict[str, Any], prefix: str = ""):
        self._left = dict(arrays)
        self._prefix = prefix

    def __contains__(self, name: str) -> bool:
        return name in self._left

    def length(self, name: str) -> int | None:
        """Size of an entry's first axis, without taking it; None if it has none."""
        shape = np.shape(self._left.get(name, ()))
        return shape[0] if shape else None

    def take(self, name: str, dtype: Any, shape: tuple[int | str, ...]) -> np.ndarray:
        """The array of that type and shape, in which a word is any size."""
        told = ", ".join(map(str, shape))
        wanted = f"`{self._prefix}{name}` must be {np.dtype(dtype)} [{told}]"
        if name not in self._left:
            raise ValueError(f"{wanted}; it is missing.")
        array = np.asarray(self._left.pop(name))
        fits = array.ndim == len(shape) and all(
            isinstance(size, str) or size == own
            for size, own in zip(shape, array.shape, strict=True)
        )
        if not fits or array.dtype != dtype:
            raise ValueError(f"{wanted}; got {array.dtype} {list(array.shape)}.")
        return array

    def finite(
        self,
        name: str,
        dtype: Any,
        shape: tuple[int | str, ...],
        low: float = -np.inf,
        high: float = np.inf,
    ) -> np.ndarray:
        """`take`, of finite numbers in a range."""
        array = self.take(name, dtype, shape)
        if not (np.isfinite(array) & (array >= low) & (array <= high)).all():
            between = "" if np.isinf([low, high]).all() else f" in {low:g}..{high:g}"
            raise ValueError(f"`{self._prefix}{name}` must hold finite numbers{between}.")
        return array

    def drop(self, name: str) -> None:
        """Let an array pass that is looked at elsewhere."""
        self._left.pop(name)

    def end(self) -> None:
        """Raise `ValueError` for what no fit has."""
        for name in self._left:
            shown = "".join(c if c.isprintable() else "?" for c in name[:80])
            raise ValueError(f"`{self._prefix}{shown}` is no entry of a fit.")


def read_facts(entries: Entries) -> tuple[dict[str, Any], bool]:
    """The settings, and whether Ctrl-C ended the fit."""
    packed = entries.take("facts", np.uint8, ("bytes",))
    if packed.size > _LONGEST_FACTS:
        raise ValueError(f"`facts` must be {_LONGEST_FACTS} bytes at most; got {packed.size}.")
    facts = _json("facts", packed)
    if facts.get("format") != FORMAT:
        raise ValueError(
            "it was not saved by this version of softras2d: `facts` must have the format "
            f"{FORMAT}; got {facts.get('format')!r:.40}."
        )
    if not isinstance(facts.get("interrupted"), bool):
        raise ValueError("`facts` must say whether the fit was `interrupted`, true or false.")
    settings = facts.get("settings")
    check_settings(settings)
    assert isinstance(settings, dict)
    return settings, facts["interrupted"]


def check_settings(settings: Any) -> None:
    """Raise `ValueError` for others than a fit can have had."""
    if not isinstance(settings, dict):
        raise ValueError("`facts` must have the `settings` of the fit; they are missing.")
    for name in _SETTINGS:
        if name not in settings:
            raise ValueError(f"`settings` must have {name!r}; it is missing.")
    for name in settings:
        if name not in _SETTINGS:
            raise ValueError(f"`settings` must not have {name!r:.60}.")
    for name in ("family", "shading", "colors", "loss", "light", "solver", "start"):
        if not isinstance(settings[name], str):
            raise ValueError(f"`settings`: {name!r} must be a word; got {settings[name]!r:.40}.")
    if not isinstance(settings["translucent"], bool):
        raise ValueError("`settings`: 'translucent' must be true or false.")
    if settings["start"] not in (*choices.STARTS, choices.GIVEN):
        raise ValueError(f"`settings`: there is no start {settings['start']!r:.40}.")
    try:
        choices.check(choices.settle(settings), None, None)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"`settings`: {error}") from None


def read_image(entries: Entries) -> np.ndarray:
    """The picture of the fit."""
    image = entries.finite("image", np.float32, ("height", "width", "3 or 4"))
    if 0 in image.shape or max(image.shape[:2]) > _MAX_SIDE or image.shape[2] not in (3, 4):
        raise ValueError(
            f"`image` must be [height, width, 3 or 4], {_MAX_SIDE} pixels a side at most; got "
            f"{list(image.shape)}."
        )
    return image


def read_scores(entries: Entries) -> tuple[float, float]:
    """PSNR, which may be infinite, and SSIM."""
    psnr, ssim = entries.take("scores", np.float64, (2,)).tolist()
    if np.isnan(psnr) or not -1.01 <= ssim <= 1.01:
        raise ValueError(f"`scores` must be a PSNR and an SSIM in -1..1; got {psnr}, {ssim}.")
    return psnr, ssim


def read_history(entries: Entries) -> np.ndarray:
    """Rows of records; those whose numbers are counts hold whole numbers."""
    history = entries.take("history", np.float64, ("records", 6))
    counts, seconds = history[:, [0, 4, 5]], history[:, 1]
    with np.errstate(invalid="ignore"):
        whole = (counts == np.floor(counts)) & (counts >= 0) & (counts < 2**53)
    if not whole.all():
        raise ValueError("`history` must count steps and triangles in whole numbers from 0 on.")
    if not (np.isfinite(seconds) & (seconds >= 0)).all() or (np.diff(counts[:, 0]) < 0).any():
        raise ValueError("`history` must have finite seconds, and steps that do not fall.")
    return history


def read_scene(entries: Entries, settings: dict[str, Any], channels: int) -> Scene:
    """The fitted scene."""
    corners = 1 if settings["shading"] == "flat" else 3
    clear = 4 if settings["translucent"] else 3
    triangles = entries.take("scene.triangles", np.int32, ("triangles", 3))
    count = len(triangles)
    most = max(2, settings["triangles"])
    if count > most:
        raise ValueError(f"`scene.triangles` must be {most} at most, as `settings` say.")
    arrays = {
        "positions": entries.take("scene.positions", np.float32, ("vertices", 2)),
        "triangles": triangles,
        "colors": entries.take("scene.colors", np.float32, (count, corners, clear)),
        "background": entries.take("scene.background", np.float32, (channels,)),
    }
    scene = Scene(**jax.tree.map(to_device, arrays))
    try:
        check(scene)
    except ValueError as error:
        raise ValueError(f"the scene: {error}") from None
    return scene


def check_state(
    state: dict[str, Any], settings: dict[str, Any], size: Size, steps: int, prefix: str = "state."
) -> None:
    """Raise `ValueError` unless a fit with these settings, of an image of that size, can go on.

    `steps`: those of the history's last record.
    """
    entries = Entries(state, prefix)
    frame = Frame.of(size.height, size.width, settings)
    small = Size(frame.height, frame.width, size.channels)
    if entries.take("steps", np.int64, ()) != steps:
        raise ValueError(f"`{prefix}steps` must be {steps}, as in the history.")
    entries.finite("image", np.float32, small)
    entries.take("target", np.uint8, (16,))
    active, exchanged = entries.finite("host", np.float64, (2,), low=0.0).tolist()
    if not active.is_integer() or active > max(2, settings["triangles"]) or exchanged > 1:
        raise ValueError(f"`{prefix}host` must be how many triangles are used, and a share.")
    if "weights" in entries or "weights.given" in entries:
        entries.finite("weights", np.float32, small[:2], low=0.0)
        given = entries.finite("weights.given", np.float32, size[:2], low=0.0)
        if not given.any():
            raise ValueError(f"`{prefix}weights.given` must not be 0 everywhere.")
    if settings["family"] == "layers":
        y = _read_layers(entries, settings, size.channels, prefix)
    else:
        y = _read_mesh(entries, settings, small, int(active), prefix)
    _read_solve(entries, settings, y, small)
    entries.end()


def _read_layers(
    entries: Entries, settings: dict[str, Any], channels: int, prefix: str
) -> list[tuple[int, ...]]:
    """What only layers have; the shapes of their unknowns."""
    corners = 1 if settings["shading"] == "flat" else 3
    count = settings["triangles"]
    # Earlier files have arrays of that many triangles, later ones of a size class.
    if entries.length("solve.0") != count:
        count = fine_class(count)
    shapes: list[tuple[int, ...]] = [(count, 3, 2), (count, corners, 3)]
    shapes += [(count,)] if settings["translucent"] else []
    entries.finite("beyond", np.float64, (), low=0.0)
    entries.finite("width", np.float32, (), low=_TINY, high=64.0)
    entries.finite("background", np.float32, (channels,))
    drawn = _json(f"{prefix}random", entries.take("random", np.uint8, ("bytes",)))
    try:
        np.random.default_rng(0).bit_generator.state = drawn
    except Exception:
        # Of NumPy: which one depends on what is wrong.
        raise ValueError(f"`{prefix}random` must be the state of a PCG64 generator.") from None
    if "kept" in entries:
        entries.finite("kept", np.float64, (), low=0.0)
        for number, shape in enumerate(shapes):
            entries.finite(f"kept.{number}", np.float32, shape)
    return shapes


def _read_mesh(
    entries: Entries, settings: dict[str, Any], size: Size, active: int, prefix: str
) -> list[tuple[int, ...]]:
    """What only a mesh has; the shapes of its unknowns."""
    most = max(4, (settings["triangles"] + 6) // 2)
    vertices = _take_mesh(entries, "mesh", size, prefix, most, active)
    shapes = _mesh_shapes(settings["shading"], vertices)
    entries.finite("scale", np.float32, (vertices, 1), low=_TINY)
    if "kept" in entries:
        entries.finite("kept", np.float64, (), low=0.0)
        own = _take_mesh(entries, "kept.mesh", size, prefix, most, None)
        entries.finite("kept.scale", np.float32, (own, 1), low=_TINY)
        for number, shape in enumerate(_mesh_shapes(settings["shading"], own)):
            entries.finite(f"kept.{number}", np.float32, shape)
    return shapes


def _mesh_shapes(shading: str, vertices: int) -> list[tuple[int, ...]]:
    if shading == "gouraud":
        return [(vertices, 2), (vertices, 3)]
    return [(vertices, 2), (2 * vertices - 6, 1 if shading == "flat" else 3, 3)]


def _take_mesh(
    entries: Entries, name: str, size: Size, prefix: str, most: int, active: int | None
) -> int:
    """Check a tiling of the canvas; how many vertices it has."""
    positions = entries.finite(f"{name}.positions", np.float64, ("vertices", 2))
    count = len(positions)
    if not 4 <= count <= most:
        raise ValueError(f"`{prefix}{name}.positions` must be 4 to {most} vertices; got {count}.")
    triangles = entries.take(
        f"{name}.triangles", np.int32, ("triangles" if active is None else active, 3)
    )
    if not ((triangles >= 0) & (triangles < count)).all() or len(triangles) > 2 * count - 6:
        raise ValueError(
            f"`{prefix}{name}.triangles` must be {2 * count - 6} at most, of vertices in "
            f"0..{count - 1}."
        )
    free = [entries.take(f"{name}.{axis}", bool, (count,)) for axis in ("free_x", "free_y")]
    mesh = Mesh(positions, triangles, *free)
    if (positions < 0).any() or (positions.max(0) != [size.width, size.height]).any():
        raise ValueError(
            f"`{prefix}{name}` must cover the fit, {size.width} x {size.height} pixels."
        )
    try:
        check_tiling(mesh)
    except ValueError as error:
        raise ValueError(f"`{prefix}{name}` must tile the canvas: {error}") from None
    return count


def _read_solve(
    entries: Entries, settings: dict[str, Any], shapes: list[tuple[int, ...]], size: Size
) -> None:
    """The unknowns and the solver's own arrays, in the order in which JAX flattens them."""
    expected = _solver_arrays(settings, shapes, size)
    if expected is None:
        # Of a solver that was handed over: `resume` compares them with what it is given.
        for number, shape in enumerate(shapes):
            entries.take(f"solve.{number}", np.float32, shape)
        number = len(shapes)
        while f"solve.{number}" in entries:
            entries.drop(f"solve.{number}")
            number += 1
        return
    for number, (dtype, shape) in enumerate(expected):
        entries.take(f"solve.{number}", dtype, shape)


def _solver_arrays(
    settings: dict[str, Any], shapes: list[tuple[int, ...]], size: Size
) -> list[tuple[Any, tuple[int, ...]]] | None:
    """Types and shapes of what a solver known by name holds, found by tracing its first step."""
    if settings["solver"] not in SOLVERS:
        return None
    solver = solver_of(settings["solver"])
    leaves = [jax.ShapeDtypeStruct(shape, np.float32) for shape in shapes]
    if isinstance(solver, optx.AbstractLeastSquaresSolver):
        # The unknowns, the best of them, and their loss.
        own = [*leaves, *leaves, jax.ShapeDtypeStruct((), np.float32)]
        return [(leaf.dtype, leaf.shape) for leaf in own]
    if settings["family"] == "layers":
        y = Layers(*leaves, *([None] if len(leaves) == 2 else []))  # pyright: ignore[reportArgumentType]
    else:
        y = Tiling(*leaves)  # pyright: ignore[reportArgumentType]

    def loss(y: Any, args: Any) -> Any:
        total = sum((jnp.sum(leaf) for leaf in jax.tree.leaves(y)), jnp.float32(0))
        return total, (jnp.zeros(size), jnp.zeros((), bool))

    with jax.enable_x64(False):
        progress = eqx.filter_eval_shape(begin, solver, loss, y, None)
    whole = jax.tree.leaves((y, progress.state))
    return [(leaf.dtype, leaf.shape) for leaf in whole if isinstance(leaf, jax.ShapeDtypeStruct)]


def _json(name: str, packed: np.ndarray) -> dict[str, Any]:
    """The object in the bytes of an entry."""
    try:
        found = json.loads(packed.tobytes().decode())
    except (ValueError, RecursionError):
        found = None
    if not isinstance(found, dict):
        raise ValueError(f"`{name}` must be an object in JSON.")
    return found
