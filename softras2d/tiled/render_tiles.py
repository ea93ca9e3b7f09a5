"""`render_tiles`: draw the windows of a large canvas one after another, on one or more devices."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

import jax
import numpy as np
from jaxtyping import Float

from ..numerics.device import Device, Devices, check_devices
from ..rendering.render import render_checked
from ..scene import Scene
from .pieces import Piece, blank_piece, padded, take_piece
from .plan_tiles import TiledPlan, host_scene
from .windows import Window

_IN_FLIGHT = 2
"""Number of windows that are started on each device before the first result is awaited."""

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
    - `windows`: numbers of the windows to draw, in this order; `plan.cut` numbers them row by row.
      By default all windows.
    - `devices`: devices that draw the windows in turn. By default JAX's first device.

    Each image is `[window.height, window.width, channels]` in the dtype of the positions: a part of
    the image that `render` would draw, as exactly as `plan_tiles` says. At most two windows per
    device are in memory, and one image for all windows without triangles.

    Raises `ValueError`, not before the first window is asked for, for a window that does not exist,
    for a traced scene or one with fewer triangles, and if triangles have moved since the plan was
    made and outgrow it. A triangle that has moved into another window is missing there: plan again.
    """
    host = host_scene(scene, plan)
    for number in () if windows is None else windows:
        if not 0 <= number < plan.cut.count:
            raise ValueError(f"`windows` must be in 0..{plan.cut.count - 1}; got {number}.")
    blank: list[Any] = []

    def draw(window: Window, device: Device) -> tuple[Any, Any]:
        piece = piece_of(host, plan, window.number)
        if piece is not None:
            return render_checked(*put_on_device(piece, plan, window.number, device))
        if not blank:
            # All windows without triangles have the same image.
            empty = put_on_device(blank_piece(host), plan, window.number, device)
            blank.append(render_checked(*empty))
        return blank[0]

    chosen = plan.cut if windows is None else map(plan.cut.window, windows)
    for window, (image, overflow) in start_in_turns(chosen, draw, devices):
        if overflow:
            raise outgrown_error(window)
        row, column = plan.offset_of(window.number)
        rows, columns = slice(row, row + window.height), slice(column, column + window.width)
        yield window, np.asarray(image)[rows, columns]


def piece_of(host: Scene, plan: TiledPlan, number: int) -> Piece | None:
    """Take the triangles of the window of this number; None if its list has no triangle.

    `host` is the scene that `host_scene` returned. If the plan has a witness
    (`pieces.with_witness`), the piece gets it as its last triangle.
    """
    triangle = plan.triangles_of(number)
    if len(triangle) == 0:
        return None
    if plan.witness is not None:
        triangle = np.append(triangle, np.int32(len(host.triangles) - 1))
    return take_piece(host, triangle)


def put_on_device(piece: Piece, plan: TiledPlan, number: int, device: Device) -> Any:
    """Put the padded scene of a piece, and the plan of the window `number`, on a device.

    Returns the scene and the plan.
    """
    return jax.device_put((padded(piece), plan.plan_at(number)), device)


def start_in_turns(
    windows: Iterable[Window],
    start: Callable[[Window, Device], T],
    devices: Devices | None,
) -> Iterator[tuple[Window, T]]:
    """Call `start(window, device)` for each window, on the devices in turn.

    Yields each window with the result of its call, in the order of `windows`. Two calls per device
    are made before the first result is yielded, so that all devices stay busy: `start` should
    return before its device has finished. If `devices` is None, JAX's first device gets all calls.
    """
    devices = jax.local_devices()[:1] if devices is None else check_devices(devices)
    started: deque[tuple[Window, T]] = deque()
    for index, window in enumerate(windows):
        started.append((window, start(window, devices[index % len(devices)])))
        if len(started) == _IN_FLIGHT * len(devices):
            yield started.popleft()
    yield from started


def outgrown_error(window: Window) -> ValueError:
    """Make the error for a scene that outgrew the plan of a window."""
    return ValueError(
        f"the scene outgrew its plan in the window at x {window.x}, y {window.y}: call "
        "softras2d.plan_tiles(scene, ...) again."
    )
