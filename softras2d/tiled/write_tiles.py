"""`write_tiles`: draw a large canvas into an image file, with memory for a few windows only."""

import os
from collections.abc import Callable
from pathlib import Path

from ..io.drafts import atomic_file
from ..io.image_stream import ImageStream, check_stream
from ..numerics.arguments import check_type
from ..numerics.device import Devices
from ..scene import Scene
from .plan_tiles import TiledPlan
from .render_tiles import render_tiles


def write_tiles(
    path: str | os.PathLike[str],
    scene: Scene,
    plan: TiledPlan,
    *,
    devices: Devices | None = None,
    linear: bool = False,
    truncate: bool = False,
    report: Callable[[int, int], None] | None = None,
) -> None:
    """Draw a canvas window by window into a PNG, TIFF (8 bits) or EXR file (float32).

    - `path`: its suffix chooses the format. TIFF and EXR files are tiled, and windows are written
      to them as soon as they are drawn; a PNG needs memory for a row of windows.
    - `scene`, `plan`, `devices`: as for `render_tiles`.
    - `linear`, `truncate`: as for `write_image`.
    - `report(done, windows)`: called after each window with the number of windows that are written,
      and the number of all windows.

    The file holds the same pixels as if `write_image` wrote one image of all windows. The file is
    written completely or not at all, also after Ctrl-C. Raises `ValueError`, with a message of one
    line, as `render_tiles` and `write_image` do.
    """
    path = Path(path)
    check_type("scene", scene, Scene)
    check_type("plan", plan, TiledPlan, "softras2d.plan_tiles(scene, ...)")
    channels = int(scene.background.shape[-1])
    check_stream(path)
    with atomic_file(path) as draft:
        shape = (plan.height, plan.width, channels)
        tile = plan.cut.tile
        with ImageStream(draft, path, shape, tile, linear=linear, truncate=truncate) as stream:
            for window, image in render_tiles(scene, plan, devices=devices):
                stream.write(window.x, window.y, image)
                if report is not None:
                    report(window.number + 1, plan.cut.count)
