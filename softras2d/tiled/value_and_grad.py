"""`tiled_value_and_grad`: the gradient of a loss that is a sum over the windows of a canvas."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from ..numerics.device import Device, Devices, to_device
from ..planning.plan import Plan
from ..rendering.render import render_checked
from ..scene import Scene
from .pieces import Piece, blank_piece
from .plan_tiles import TiledPlan, host_scene
from .render_tiles import outgrown_error, piece_of, put_on_device, start_in_turns
from .windows import Window

_TRIANGLE_FIELDS = ("colors", "uv")
"""Fields of `Scene` that are arrays of floats with one row per triangle."""

_VERTEX_FIELDS = ("positions", "depth", "inverse_w")
"""Fields of `Scene` that are arrays of floats with one row per vertex."""


def tiled_value_and_grad(
    loss: Callable[..., Float[Array, ""]], *, devices: Devices | None = None
) -> Callable[..., tuple[float, Scene]]:
    """Differentiate a loss that is a sum over windows, with respect to every float of a scene.

    - `loss(image, *windows_of_data)`: returns the loss of one window, a scalar. JAX traces it.
      `image` is the image of the window, `[height, width, channels]`. Windows of the last row and
      column may be smaller, and are compiled separately.
    - `devices`: devices that compute the windows in turn. By default JAX's first device.

    Returns a function of a scene, a `TiledPlan` made with `gradients=True`, and any number of
    arrays `[height, width, ...]` of the canvas, such as a target image. The arrays are cut into
    windows as they are needed, so that they may be memory-mapped. The function returns the sum of
    the losses, and its gradient: a scene whose arrays of floats hold derivatives, in the dtype of
    the positions, and whose arrays of integers are None.

    Sums over windows are taken in float64 in the order of the windows, so that they do not depend
    on the number of devices. For a mean over the canvas, divide the loss of each window by the
    number of pixels of the canvas.

    The function raises `ValueError` for a plan without `gradients`, for data that are no arrays of
    the size of the canvas, for a traced scene or one with fewer triangles, and if triangles have
    moved since the plan was made and outgrow it. A triangle that has moved into another window is
    missing there, from loss and gradient: plan again.
    """

    @eqx.filter_jit
    def of_window(
        scene: Scene, plan: Plan, data: tuple[Array, ...], offset: Array, size: tuple[int, int]
    ) -> tuple[Array, Array, Scene]:
        def value_of(scene: Scene) -> tuple[Array, Array]:
            image, overflow = render_checked(scene, plan)
            # The offset is traced, so that windows at the border of the canvas share the program.
            start = (offset[0], offset[1], 0)
            image = jax.lax.dynamic_slice(image, start, (*size, image.shape[-1]))
            return loss(image, *data), overflow

        (value, overflow), gradient = eqx.filter_value_and_grad(value_of, has_aux=True)(scene)
        return value, overflow, gradient

    def value_and_grad(scene: Scene, plan: TiledPlan, *data: Any) -> tuple[float, Scene]:
        host = host_scene(scene, plan)
        _check(plan, data)
        blank = blank_piece(host)

        def start(window: Window, device: Device) -> tuple[Piece, Any]:
            piece = piece_of(host, plan, window.number) or blank
            cut = tuple(np.asarray(array[window.rows, window.columns]) for array in data)
            drawn, window_plan = put_on_device(piece, plan, window.number, device)
            size = (window.height, window.width)
            offset = np.array(plan.offset_of(window.number), np.int32)
            arrays, offset = jax.device_put((cut, offset), device)
            return piece, of_window(drawn, window_plan, arrays, offset, size)

        total, sums = 0.0, _zeros(scene)
        for window, (piece, (value, overflow, gradient)) in start_in_turns(
            plan.cut, start, devices
        ):
            if overflow:
                raise outgrown_error(window)
            total += float(value)
            _add(sums, piece, gradient)
        return total, _as_scene(scene, sums)

    return value_and_grad


def _check(plan: TiledPlan, data: Sequence[Any]) -> None:
    """Raise `ValueError` for a plan without gradients, and for data of another size or type."""
    if not plan.has_gradients:
        raise ValueError("`tiled_value_and_grad` needs a plan by plan_tiles(..., gradients=True).")
    for array in data:
        if not hasattr(array, "shape"):
            raise ValueError(
                f"data must be arrays [{plan.height}, {plan.width}, ...], as the canvas; "
                f"got {type(array).__name__}."
            )
        if tuple(array.shape[:2]) != (plan.height, plan.width):
            raise ValueError(
                f"data must be [{plan.height}, {plan.width}, ...], as the canvas; "
                f"got shape {tuple(array.shape)}."
            )


def _zeros(scene: Scene) -> dict[str, np.ndarray]:
    """Make an array of zeros, in float64, for every float array of a scene, by the array's name.

    The name is that of the field of `Scene`; for the textures it is "texels".
    """
    names = [
        name for name in (*_TRIANGLE_FIELDS, *_VERTEX_FIELDS) if getattr(scene, name) is not None
    ]
    sums: dict[str, np.ndarray] = {
        name: np.zeros(getattr(scene, name).shape) for name in (*names, "background")
    }
    if scene.textures is not None:
        sums["texels"] = np.zeros(scene.textures.texels.shape)
    return sums


def _add(sums: dict[str, np.ndarray], piece: Piece, gradient: Scene) -> None:
    """Add the gradient with respect to a piece to the gradient with respect to the whole scene.

    - `sums`: the gradient with respect to the whole scene, by the name of the array; changed in
      place.
    - `gradient`: the gradient with respect to the padded scene of `piece`.
    """
    for name, total in sums.items():
        if name == "texels":
            assert gradient.textures is not None
            total += np.asarray(gradient.textures.texels)
        elif name == "background":
            total += np.asarray(gradient.background)
        else:
            index = piece.triangle if name in _TRIANGLE_FIELDS else piece.vertex
            # The witness of `Area("sum")` comes last, and is no entry of the scene.
            index = index[index < len(total)]
            np.add.at(total, index, np.asarray(getattr(gradient, name))[: len(index)])


def _as_scene(scene: Scene, sums: dict[str, np.ndarray]) -> Scene:
    """Return `sums`, arrays by name, as a scene in the dtype of the positions of `scene`.

    Arrays of integers are None in the result.
    """
    names = [name for name in sums if name != "texels"]
    dtype = scene.positions.dtype
    gradient = eqx.tree_at(
        lambda scene: [getattr(scene, name) for name in names],
        eqx.filter(scene, eqx.is_inexact_array),
        [to_device(sums[name], dtype) for name in names],
    )
    if scene.textures is None:
        return gradient
    texels = to_device(sums["texels"], dtype)
    return eqx.tree_at(lambda scene: scene.textures.texels, gradient, texels)
