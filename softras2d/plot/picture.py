"""Shows one image, optionally with a pixel grid and an enlarged inset."""

from typing import Any

import numpy as np

from .cells import new_cells
from .library import COLORS, Axes, import_pyplot

INSET = "inset of softras2d.plot.show"
"""Label of the axes that `show` makes for an inset, by which `triangles` and `arrows` find them."""

_CHECKERBOARD_GREYS = (1.0, 0.9)
"""Greys, in 0..1, of the checkerboard behind images with alpha."""

_MAX_GRID_LINES = 64
"""Largest number of cells of the pixel grid along a side of an image; more pixels share cells."""

_MAX_INSET = 0.6
"""Largest height and width of an inset, as a fraction of those of the image."""


def show(
    image: Any,
    *,
    axes: Axes | None = None,
    title: str = "",
    grid: bool = False,
    inset: tuple[int, int, int, int] | None = None,
    inset_zoom: int | float = 8,
) -> Axes:
    """Show one image; its pixels are drawn as squares.

    - `image`: floats `[height, width, channels]` in sRGB, 0..1, of 1, 3 or 4 channels; values
      outside are clipped. Straight alpha is shown over a checkerboard.
    - `axes`: matplotlib axes to draw into; by default the axes of a new figure.
    - `title`: text above the image.
    - `grid`: whether to draw lines between the pixels and to number the axes in pixels. If a side
      has more than 64 pixels, there is one line for every 2, 4, 8, ... pixels.
    - `inset`: the part of the image to enlarge, `(top, left, height, width)` in pixels. It is drawn
      in the corner of the image that is farthest from this part, and becomes the last of
      `axes.child_axes`. Overlays (`triangles`, `arrows`) are drawn in the inset too.
    - `inset_zoom`: magnification of the inset, more than 1. It is reduced if the inset would be
      larger than 0.6 of a side of the image.

    Returns the axes. If a pixel is less than 1.5 dots of the screen wide, but not exactly one, the
    image is smoothed as matplotlib decides, since leaving out pixels would add aliasing. Raises
    `ValueError`, with a message of one line, for another shape or dtype, for NaN and infinity, for
    an inset that is not four integers, not inside the image or too large to be enlarged, and, with
    an inset, for an `inset_zoom` that is not more than 1.
    """
    pixels = checked_image("`image`", image)
    height, width = pixels.shape[:2]
    region = None if inset is None else _checked_inset(inset, height, width)
    if region is not None and not inset_zoom > 1:
        raise ValueError(f"`inset_zoom` must be more than 1; got {inset_zoom}.")
    if axes is None:
        _, (axes,) = new_cells(1, 1, height, width, lines=1 if title else 0, ticks=grid)
    _draw(axes, pixels, (0, width, height, 0))
    if grid:
        _draw_grid(axes, 0, 0, height, width)
        axes.set(xlabel="x (pixels)", ylabel="y (pixels)")
    else:
        axes.set(xticks=[], yticks=[])
    if title:
        axes.set_title(title)
    if region is not None:
        _draw_inset(axes, pixels, region, inset_zoom, grid)
    return axes


def checked_image(name: str, image: Any) -> np.ndarray:
    """Return `image` as float32 `[height, width, channels]`, with 1, 3 or 4 channels.

    Raises `ValueError`, whose message begins with `name`, if it is not an image.
    """
    # Imported here, since it loads OpenImageIO, which `import softras2d.plot` does not need.
    from ..io.pixel_values import as_pixels

    return as_pixels(name, np.asarray(image))


def fit_pixels(axes: Axes, height: int, width: int) -> str:
    """Choose the interpolation with which matplotlib draws an image of `height` x `width` pixels.

    Returns `"nearest"` if each pixel is one dot of the screen wide, or at least 1.5 dots; else
    `"auto"`. `axes`: the axes to draw into, which decide the size of a pixel.
    """
    box = axes.get_window_extent()
    dots = min(box.width / width, box.height / height)
    # A layout may still shrink the axes. "auto" decides when the figure is drawn.
    return "nearest" if dots >= 1.5 or abs(dots - 1) < 1e-3 else "auto"


def _draw(axes: Axes, pixels: np.ndarray, extent: tuple[int, int, int, int]) -> None:
    """Draw an image `[height, width, channels]`, so that it fills a rectangle of the axes.

    `extent`: the rectangle (left, right, bottom, top), in coordinates of the axes, which also
    become the limits of the axes.
    """
    height, width, channels = pixels.shape
    pixels = np.clip(pixels, 0, 1)
    left, right, bottom, top = extent
    # Overlays that are drawn later must not change the limits.
    axes.set(xlim=(left, right), ylim=(bottom, top), autoscale_on=False)
    interpolation = fit_pixels(axes, height, width)
    if channels == 1:
        grey = pixels[..., 0]
        axes.imshow(grey, cmap="gray", vmin=0, vmax=1, extent=extent, interpolation=interpolation)
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
    axes.imshow(pixels, extent=extent, interpolation=interpolation)


def _checkerboard(height: int, width: int) -> np.ndarray:
    """Make a checkerboard `[rows, columns]` of two greys, with about 24 squares on the longer side.

    `height` and `width` are the size, in pixels, of the image behind which it is shown.
    """
    field = max(height, width) / 24
    rows, columns = (max(1, round(side / field)) for side in (height, width))
    return np.asarray(_CHECKERBOARD_GREYS)[np.indices((rows, columns)).sum(0) % 2]


def _draw_grid(axes: Axes, top: int, left: int, height: int, width: int) -> None:
    """Draw lines between the pixels of a rectangle, which is given in pixels of the image.

    If a side has more than `_MAX_GRID_LINES` pixels, there is one line for every 2, 4, 8, ...
    pixels.
    """
    import_pyplot()
    from matplotlib.collections import LineCollection

    step = 1
    while max(height, width) / step > _MAX_GRID_LINES:
        step *= 2
    right, bottom = left + width, top + height
    horizontal = [[(left, y), (right, y)] for y in range(top, bottom + 1, step)]
    vertical = [[(x, top), (x, bottom)] for x in range(left, right + 1, step)]
    lines = LineCollection(horizontal + vertical, colors="0.5", linewidths=0.4)
    axes.add_collection(lines, autolim=False)


def _checked_inset(
    inset: tuple[int, int, int, int], height: int, width: int
) -> tuple[int, int, int, int]:
    """Return an inset, (top, left, height, width), as integers, after a check.

    Raises `ValueError` unless it lies inside the image of `height` x `width` pixels, and is smaller
    than `_MAX_INSET` of the image.
    """
    region = np.asarray(inset)
    if region.shape != (4,) or region.dtype.kind not in "iu":
        raise ValueError(f"`inset` must be (top, left, height, width) in pixels; got {inset}.")
    top, left, tall, wide = (int(number) for number in region)
    if min(top, left) < 0 or min(tall, wide) < 1 or top + tall > height or left + wide > width:
        raise ValueError(
            f"`inset` must lie inside the image of height {height}, width {width}; got {inset}."
        )
    if max(tall / height, wide / width) >= _MAX_INSET:
        raise ValueError(
            f"`inset` must be smaller than {_MAX_INSET} of the image of height {height}, "
            f"width {width}, to be enlarged in it; got {inset}."
        )
    return top, left, tall, wide


def _draw_inset(
    axes: Axes, pixels: np.ndarray, region: tuple[int, int, int, int], zoom: int | float, grid: bool
) -> None:
    """Draw a region of an image, enlarged, in the corner of the axes farthest from the region.

    Coloured lines frame the inset and the region, and connect them.

    - `pixels`: the image, `[height, width, channels]`.
    - `region`: (top, left, height, width) in pixels.
    - `zoom`: the magnification, which is reduced if the inset would be larger than `_MAX_INSET`.
    - `grid`: whether to draw lines between pixels.
    """
    height, width = pixels.shape[:2]
    top, left, tall, wide = region
    zoom = min(zoom, _MAX_INSET * height / tall, _MAX_INSET * width / wide)
    # Size and margins as fractions of the axes.
    inset_width, inset_height = zoom * wide / width, zoom * tall / height
    margin_x, margin_y = 0.02 * max(height, width) / np.array([width, height])
    x = 1 - inset_width - margin_x if left + wide / 2 <= width / 2 else margin_x
    y = margin_y if top + tall / 2 <= height / 2 else 1 - inset_height - margin_y
    child = axes.inset_axes((float(x), float(y), inset_width, inset_height), label=INSET)
    _draw(child, pixels[top : top + tall, left : left + wide], (left, left + wide, top + tall, top))
    if grid:
        _draw_grid(child, *region)
    child.set(xticks=[], yticks=[])
    child.spines[:].set(color=COLORS[1], linewidth=1.5)
    axes.indicate_inset(inset_ax=child, edgecolor=COLORS[1], linewidth=1.5, alpha=1)
