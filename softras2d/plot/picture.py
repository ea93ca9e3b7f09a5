"""Shows one image, optionally with a pixel grid and an enlarged inset."""

from typing import Any

import numpy as np

from .cells import new_cells
from .library import COLORS, Axes, import_pyplot

INSET = "inset of softras2d.plot.show"
"""Label of the axes that `show` makes for an inset; overlays look for it."""

_PAPER = (1.0, 0.9)
"""Greys of the checkerboard behind images with alpha."""

_MOST_LINES = 64
"""Maximum number of lines of the pixel grid along a side."""

_LARGEST_INSET = 0.6
"""Maximum size of an inset, as a fraction of a side of the image."""


def show(
    image: Any,
    *,
    axes: Axes | None = None,
    title: str = "",
    grid: bool = False,
    inset: tuple[int, int, int, int] | None = None,
    inset_zoom: int | float = 8,
) -> Axes:
    """Show `image` `[height, width, 1, 3 or 4]`, its pixels as squares.

    - `grid`: lines between the pixels and axes in pixels; beyond 64 pixels a side, lines between
      every 2nd, 4th, ... of them. An inset has lines of its own.
    - `inset`: `(top, left, height, width)` in pixels: that part, enlarged `inset_zoom` times or as
      often as fits 0.6 of a side, in the corner that is farthest from it. It is
      `axes.child_axes[0]`; overlays are drawn there too.

    An image with more pixels than `axes` has dots on the screen is smoothed: to leave pixels out
    would add aliasing. Raises `ValueError`, one line, for NaN and infinity, another shape or dtype,
    and an inset that is not inside the image or too large to be enlarged.
    """
    pixels = checked_image("`image`", image)
    height, width = pixels.shape[:2]
    part = None if inset is None else _checked_part(inset, height, width)
    if part is not None and not inset_zoom > 1:
        raise ValueError(f"`inset_zoom` must be more than 1; got {inset_zoom}.")
    if axes is None:
        _, (axes,) = new_cells(1, 1, height, width, lines=1 if title else 0, ticks=grid)
    _draw(axes, pixels, (0, width, height, 0))
    if grid:
        _pixel_grid(axes, 0, 0, height, width)
        axes.set(xlabel="x (pixels)", ylabel="y (pixels)")
    else:
        axes.set(xticks=[], yticks=[])
    if title:
        axes.set_title(title)
    if part is not None:
        _inset(axes, pixels, part, inset_zoom, grid)
    return axes


def checked_image(name: str, image: Any) -> np.ndarray:
    """`image` as float32. Raises `ValueError`, which begins with `name`, if it is not an image."""
    # Imported here, since it loads OpenImageIO, which `import softras2d.plot` does not need.
    from ..io.images import as_pixels

    return as_pixels(name, np.asarray(image))


def fit_pixels(axes: Axes, height: int, width: int) -> str:
    """Interpolation for an image of this size: `"nearest"` if `axes` has a dot for each pixel."""
    box = axes.get_window_extent()
    dots = min(box.width / width, box.height / height)
    # Layouts may still shrink the axes; "auto" decides when it is drawn, by the dots there are.
    return "nearest" if dots >= 1.5 or abs(dots - 1) < 1e-3 else "auto"


def _draw(axes: Axes, pixels: np.ndarray, extent: tuple[int, int, int, int]) -> None:
    """`pixels` on the rectangle `extent` (left, right, bottom, top) of `axes`."""
    height, width, channels = pixels.shape
    pixels = np.clip(pixels, 0, 1)
    left, right, bottom, top = extent
    # What is drawn over it does not change the limits.
    axes.set(xlim=(left, right), ylim=(bottom, top), autoscale_on=False)
    how = fit_pixels(axes, height, width)
    if channels == 1:
        grey = pixels[..., 0]
        axes.imshow(grey, cmap="gray", vmin=0, vmax=1, extent=extent, interpolation=how)
        return
    if channels == 4:
        axes.imshow(
            _checkerboard(height, width),
            cmap="gray",
            vmin=0,
            vmax=1,
            extent=extent,
            interpolation="nearest",
        )
    axes.imshow(pixels, extent=extent, interpolation=how)


def _checkerboard(height: int, width: int) -> np.ndarray:
    """Two light greys, about 24 fields along the longer side."""
    field = max(height, width) / 24
    rows, columns = (max(1, round(side / field)) for side in (height, width))
    return np.asarray(_PAPER)[np.indices((rows, columns)).sum(0) % 2]


def _pixel_grid(axes: Axes, top: int, left: int, height: int, width: int) -> None:
    import_pyplot()
    from matplotlib.collections import LineCollection

    step = 1
    while max(height, width) / step > _MOST_LINES:
        step *= 2
    right, bottom = left + width, top + height
    across = [[(left, y), (right, y)] for y in range(top, bottom + 1, step)]
    down = [[(x, top), (x, bottom)] for x in range(left, right + 1, step)]
    lines = LineCollection(across + down, colors="0.5", linewidths=0.4)
    axes.add_collection(lines, autolim=False)


def _checked_part(
    inset: tuple[int, int, int, int], height: int, width: int
) -> tuple[int, int, int, int]:
    part = np.asarray(inset)
    if part.shape != (4,) or part.dtype.kind not in "iu":
        raise ValueError(f"`inset` must be (top, left, height, width) in pixels; got {inset}.")
    top, left, tall, wide = (int(number) for number in part)
    if min(top, left) < 0 or min(tall, wide) < 1 or top + tall > height or left + wide > width:
        raise ValueError(
            f"`inset` must lie inside the image of height {height}, width {width}; got {inset}."
        )
    if max(tall / height, wide / width) >= _LARGEST_INSET:
        raise ValueError(
            f"`inset` must be smaller than {_LARGEST_INSET} of the image of height {height}, "
            f"width {width}, to be enlarged in it; got {inset}."
        )
    return top, left, tall, wide


def _inset(
    axes: Axes, pixels: np.ndarray, part: tuple[int, int, int, int], zoom: int | float, grid: bool
) -> None:
    """The part (top, left, height, width), enlarged in the corner farthest from it."""
    height, width = pixels.shape[:2]
    top, left, tall, wide = part
    zoom = min(zoom, _LARGEST_INSET * height / tall, _LARGEST_INSET * width / wide)
    across, up = zoom * wide / width, zoom * tall / height
    margin_x, margin_y = 0.02 * max(height, width) / np.array([width, height])
    x = 1 - across - margin_x if left + wide / 2 <= width / 2 else margin_x
    y = margin_y if top + tall / 2 <= height / 2 else 1 - up - margin_y
    child = axes.inset_axes((float(x), float(y), across, up), label=INSET)
    _draw(child, pixels[top : top + tall, left : left + wide], (left, left + wide, top + tall, top))
    if grid:
        _pixel_grid(child, *part)
    child.set(xticks=[], yticks=[])
    child.spines[:].set(color=COLORS[1], linewidth=1.5)
    axes.indicate_inset(inset_ax=child, edgecolor=COLORS[1], linewidth=1.5, alpha=1)
