"""Shows several images: side by side, as the levels of a mip pyramid, or as an animation."""

import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..color import unpremultiply
from .cells import columns_for, new_cells
from .library import AnyFigure
from .picture import checked_image, show

if TYPE_CHECKING:
    from ..texture.pyramid import TexturePyramid
else:
    # The type alone would import JAX.
    TexturePyramid = Any


def film_strip(
    frames: Iterable[Any],
    *,
    titles: Sequence[str] = (),
    columns: int | None = None,
    figure: AnyFigure | None = None,
) -> AnyFigure:
    """Show images side by side, in rows from left to right.

    - `frames`: float images `[height, width, channels]` in sRGB, 0..1, of 1, 3 or 4 channels, with
      straight alpha. Their sizes may differ; each is scaled, without distortion, to fit into a cell
      of the same size.
    - `titles`: none, or one for each image, drawn above it.
    - `columns`: number of images in a row, at least 1; by default as many as fit, at most 6.
    - `figure`: matplotlib figure to draw into; by default a new one.

    Returns the figure. Raises `ValueError`, with a message of one line, for no frames, a frame that
    is not an image, another number of titles, and `columns` below 1.
    """
    images = [checked_image(f"frame {number}", frame) for number, frame in enumerate(frames)]
    if not images:
        raise ValueError("`frames` must hold at least one image; got none.")
    if len(titles) not in (0, len(images)):
        raise ValueError(f"`titles` must be none or {len(images)}; got {len(titles)}.")
    if columns is not None and columns < 1:
        raise ValueError(f"`columns` must be positive; got {columns}.")
    height, width = np.max([image.shape[:2] for image in images], axis=0).tolist()
    columns = columns_for(len(images), width) if columns is None else min(columns, len(images))
    if figure is None:
        lines = max((title.count("\n") + 1 for title in titles if title), default=0)
        figure, cells = new_cells(len(images), columns, height, width, lines=lines)
    else:
        grid = figure.subplots(-(-len(images) // columns), columns, squeeze=False).ravel()
        cells = grid[: len(images)]
        for unused in grid[len(images) :]:
            unused.remove()
    for cell, image, title in zip(cells, images, titles or [""] * len(images), strict=True):
        show(image, axes=cell)
        cell.set_title(title, fontsize="medium")
    return figure


def pyramid(
    textures: TexturePyramid, index: int = 0, *, figure: AnyFigure | None = None
) -> AnyFigure:
    """Show the mip levels of one texture, from the finest to the coarsest.

    - `textures`: the textures of a scene.
    - `index`: index of the texture, 0 to `textures.count - 1`.
    - `figure`: matplotlib figure to draw into; by default a new one.

    All levels are drawn in cells of the same size; titles give their width x height in texels.
    Returns the figure. Raises `ValueError` for an `index` outside its range.
    """
    if not 0 <= index < textures.count:
        raise ValueError(f"`index` must be 0 to {textures.count - 1}; got {index}.")
    # If another texture has more levels, the last level of this one is repeated in the table.
    table = np.unique(np.asarray(textures.levels)[index], axis=0)
    texels = np.asarray(textures.texels)
    levels = [
        unpremultiply(texels[offset : offset + height * width]).reshape(height, width, -1)
        for offset, height, width in table.tolist()
    ]
    titles = [
        f"level {number}: {level.shape[1]} x {level.shape[0]}"
        for number, level in enumerate(levels)
    ]
    return film_strip(levels, titles=titles, figure=figure)


def animate(
    path: str | os.PathLike[str], frames: Iterable[Any], *, seconds_per_frame: int | float = 0.1
) -> Path:
    """Write images as a GIF that repeats endlessly.

    - `path`: file to write; its suffix must be `.gif`, in capitals or not.
    - `frames`: float images `[height, width, channels]` of equal size, in sRGB, 0..1, of 1, 3 or 4
      channels; values outside are clipped, and alpha is composited over white. They may come from
      a generator.
    - `seconds_per_frame`: time of each frame, 0.02 to 655.35 seconds, rounded to 1/100 s.

    Returns the path. Raises `ValueError`, with a message of one line, as
    `softras2d.io.animation.write_animation` does: for another suffix, no frames, frames of unequal
    shape, NaN and infinity, and a time outside its range.
    """
    from ..io.animation import write_animation

    path = Path(path)
    write_animation(
        path, _opaque(path, frames), seconds_per_frame=float(seconds_per_frame), hold_seconds=0.0
    )
    return path


def _opaque(path: Path, frames: Iterable[Any]) -> Iterator[np.ndarray]:
    """Convert frames to RGB: grey is repeated, and alpha is composited over white.

    `path`: file that is named in the message if a frame is not an image.
    """
    for number, frame in enumerate(frames):
        pixels = checked_image(f"{path}: frame {number}", frame)
        if pixels.shape[-1] == 4:
            colors, alpha = np.clip(pixels[..., :3], 0, 1), np.clip(pixels[..., 3:], 0, 1)
            pixels = colors * alpha + (1 - alpha)
        yield np.repeat(pixels, 3, axis=-1) if pixels.shape[-1] == 1 else pixels
