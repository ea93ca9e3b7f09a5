"""`render_tiles`: draws the windows of a large canvas one after another, on one or more devices."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

import jax
import numpy as np
from jaxtyping import Float

from ..numerics.device import Device, Devices
from ..rendering.render import render_checked
from ..scene import Scene
from .pieces import Piece, blank_piece, padded, take_piece
from .plan_tiles import TiledPlan, host_scene
from .windows import Window

_IN_FLIGHT = 2
"""Windows that a device is given before the first of them is waited for."""

T = TypeVar("T")


def render_tiles(
    scene: Scene,
    plan: TiledPlan,
    *,
    windows: Sequence[int] | None = None,
    devices: Devices | None = None,
) -> Iterator[tuple[Window, Float[np.ndarray, "height width channels"]]]:
    """Draw windows of a canvas one after another; yields each window with its image.

    - `scene`: the scene that was planned.
    - `windows`: numbers of the windows to draw, in this order (`plan.cut` counts them row by row).
      All of them unless given.
    - `devices`: windows go to them in turn. JAX's first device unless given.

    Images are those of `render`, `[window.height, window.width, channels]` in the dtype of the
    positions. Memory is that of two windows for each device.

    Raises `ValueError` if triangles have moved since the plan was made and outgrow it. Triangles
    that moved into another window are not drawn there: plan again.
    """
    host = host_scene(scene, plan)
    blank: list[Any] = []

    def draw(window: Window, device: Device) -> tuple[Any, Any]:
        piece = piece_of(host, plan, window.number)
        if piece is not None:
            return render_checked(*placed(piece, plan, window.number, device))
        if not blank:
            # All windows without triangles have the same image.
            empty = placed(blank_piece(host), plan, window.number, device)
            blank.append(render_checked(*empty))
        return blank[0]

    chosen = plan.cut if windows is None else map(plan.cut.window, windows)
    for window, (image, overflow) in in_turns(chosen, draw, devices):
        if overflow:
            raise outgrown(window)
        inside = slice(plan.border, None)
        yield window, np.asarray(image)[inside, inside][: window.height, : window.width]


def piece_of(host: Scene, plan: TiledPlan, number: int) -> Piece | None:
    """The part of a scene on the host that a window shows; None if no triangle comes near it."""
    triangle = plan.triangles_of(number)
    if len(triangle) == 0:
        return None
    if plan.witness is not None:
        triangle = np.append(triangle, np.int32(len(host.triangles) - 1))
    return take_piece(host, triangle)


def placed(piece: Piece, plan: TiledPlan, number: int, device: Device) -> Any:
    """The padded scene of a piece and the plan of its window, on a device."""
    return jax.device_put((padded(piece), plan.plan_at(number)), device)


def in_turns(
    windows: Iterable[Window],
    start: Callable[[Window, Device], T],
    devices: Devices | None,
) -> Iterator[tuple[Window, T]]:
    """Start work on each window, on the devices in turn; yields results in the order of windows."""
    devices = jax.local_devices()[:1] if devices is None else list(devices)
    if not devices:
        raise ValueError("`devices` must name one device at least; got none.")
    started: deque[tuple[Window, T]] = deque()
    for index, window in enumerate(windows):
        started.append((window, start(window, devices[index % len(devices)])))
        if len(started) == _IN_FLIGHT * len(devices):
            yield started.popleft()
    yield from started


def outgrown(window: Window) -> ValueError:
    """The error for a scene that outgrew the plan of a window."""
    return ValueError(
        f"the scene outgrew its plan in the window at x {window.x}, y {window.y}: call "
        "softras2d.plan_tiles(scene, ...) again."
    )
