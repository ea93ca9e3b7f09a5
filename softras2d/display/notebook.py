"""Shows values in notebooks: a picture above the text of `repr`, as HTML.

IPython, and the front ends that follow it, call the method `_repr_html_` of the last value of a
cell. If it returns None, they show the text of `repr` alone. Nothing here needs matplotlib.
"""

import base64
import html
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from ..color import premultiply, unpremultiply
from .scene_picture import scene_picture

_MAX_SIDE = 640
"""Largest number of pixels along a side of an image. Larger images are shrunk, because notebooks
store all that they show."""

_CHECKERBOARD = "background: repeating-conic-gradient(#fff 0 25%, #e6e6e6 0 50%) 0 0 / 16px 16px"
"""CSS of a checkerboard, which is shown where an image is transparent."""


def scene_html(scene: Any) -> str | None:
    """HTML of a small picture of a scene, above the text of its `repr`.

    None if the scene cannot be drawn, or if `scene_picture` refuses to draw it because that would
    take long.
    """
    return _html(lambda: scene_picture(scene), repr(scene))


def image_html(image: Any, text: str) -> str | None:
    """HTML of an image, `[height, width, 1, 3 or 4]` in 0..1, above a text.

    Images of more than `_MAX_SIDE` pixels a side are shrunk. None if it is not an image, or has NaN
    or infinity.
    """
    return _html(lambda: _shrunk(np.asarray(image, np.float32)), text)


def buffers_html(visible: Any, text: str) -> str | None:
    """HTML of a picture with one colour for each visible triangle, above a text.

    `visible`: a `Visibility`, which is the result of `rasterize`, with one layer. None is returned
    for several layers, and for anything else that cannot be shown.
    """

    def draw() -> np.ndarray:
        import softras2d as sr

        return _shrunk(sr.plot.id_colors(visible.triangle))

    return _html(draw, text)


def _html(draw: Callable[[], np.ndarray | None], text: str) -> str | None:
    """HTML of the image that `draw` returns, above `text`; None if it returns None or raises."""
    try:
        image = draw()
        data = None if image is None else _png(image)
    except Exception:
        # For somebody who only looks at a value, its text is more useful than a traceback.
        return None
    if image is None or data is None:
        return None
    source = f"data:image/png;base64,{base64.b64encode(data).decode()}"
    style = _CHECKERBOARD if image.shape[-1] == 4 else ""
    escaped = html.escape(text)
    first_line = escaped.partition("\n")[0]
    return (
        f'<img src="{source}" alt="{first_line}" style="{style}">'
        f'<pre style="white-space: pre-wrap">{escaped}</pre>'
    )


def _png(image: Float[np.ndarray, "height width channels"]) -> bytes:
    """Encode an image as the bytes of a PNG file, with 8 bits per channel.

    `image`: grey, RGB or RGBA in sRGB, with straight alpha; values are clipped to 0..1. Raises
    `ValueError` for NaN and infinity, and for another number of channels.
    """
    # The writer is in a stage below this one; `scene_picture.py` says why it is imported here.
    import softras2d as sr

    # The Python binding of OpenImageIO can write to files only.
    with tempfile.TemporaryDirectory(prefix="softras2d-") as folder:
        path = Path(folder) / "picture.png"
        sr.write_image(path, image)
        return path.read_bytes()


def _shrunk(image: Float[np.ndarray, "height width channels"]) -> Float[np.ndarray, "h w channels"]:
    """Shrink an image until no side is longer than `_MAX_SIDE`; smaller images are unchanged.

    Each pixel of the result is the mean, weighted by alpha, over a square block of pixels of the
    image. Blocks at the right and bottom border may be cut off.
    """
    block = -(-max(image.shape[:2]) // _MAX_SIDE)
    if block <= 1:
        return image
    # Premultiplied, so that transparent pixels do not bleed their colour.
    sums, count = premultiply(image), np.ones((*image.shape[:2], 1), image.dtype)
    for axis in (0, 1):
        # The last block may be smaller, so pixels are counted.
        starts = np.arange(0, image.shape[axis], block)
        sums, count = (np.add.reduceat(array, starts, axis) for array in (sums, count))
    return unpremultiply(sums / count)
