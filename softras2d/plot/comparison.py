"""Shows how an image differs from a reference."""

from typing import Any

import numpy as np
from jaxtyping import Float64

from ..color import premultiply
from .library import Axes, import_pyplot
from .picture import checked_image, fit_pixels

_EQUAL_LIMIT = 1 / 255
"""Limit of the colour scale for equal images: one step of an 8-bit image."""


def difference(
    image: Any,
    reference: Any,
    *,
    axes: Axes | None = None,
    limit: int | float | None = None,
    title: str = "",
) -> Axes:
    """Show `image - reference` per pixel: red where `image` is brighter, blue where it is darker.

    - `image`, `reference`: float images `[height, width, channels]` of one shape, in sRGB, 0..1, of
      1, 3 or 4 channels. Four channels are RGBA with straight alpha; colours are premultiplied
      before they are compared, and alpha counts as a channel.
    - `axes`: matplotlib axes to draw into; by default the axes of a new figure.
    - `limit`: difference that gets the strongest colour, above 0, where 1 is the full range of an
      image; by default the largest absolute difference, or 1/255 if that is 0.
    - `title`: text above the plot.

    The difference of a pixel is the mean over its channels. Differences of opposite signs in two
    channels therefore cancel; `error` shows them. Returns the axes. Raises `ValueError`, with a
    message of one line, for images of other types, of other or unequal shapes, with NaN or
    infinity, and for a `limit` that is not positive and finite.
    """
    values = _difference(image, reference).mean(axis=-1)
    limit = _limit(limit, values)
    label = "image - reference"
    return _draw_map(values, "RdBu_r", (-limit, limit), label, axes, title)


def error(
    image: Any,
    reference: Any,
    *,
    axes: Axes | None = None,
    limit: int | float | None = None,
    title: str = "",
) -> Axes:
    """Show the root-mean-square difference of two images over the channels of each pixel.

    - `image`, `reference`: float images `[height, width, channels]` of one shape, in sRGB, 0..1, of
      1, 3 or 4 channels. Four channels are RGBA with straight alpha; colours are premultiplied
      before they are compared, and alpha counts as a channel.
    - `axes`: matplotlib axes to draw into; by default the axes of a new figure.
    - `limit`: error that gets the last colour of the scale, above 0, where 1 is the full range of
      an image; by default the largest error, or 1/255 if that is 0.
    - `title`: text above the plot.

    Returns the axes. Raises `ValueError` as `difference` does.
    """
    values = np.sqrt(np.square(_difference(image, reference)).mean(axis=-1))
    limit = _limit(limit, values)
    return _draw_map(values, "viridis", (0.0, limit), "RMSE", axes, title)


def _difference(image: Any, reference: Any) -> Float64[np.ndarray, "height width channels"]:
    """Check two images; return the difference of their premultiplied colours.

    The difference is `image` minus `reference`. Raises `ValueError` for an array that is not an
    image, and for images of unequal shapes.
    """
    first, second = checked_image("`image`", image), checked_image("`reference`", reference)
    if first.shape != second.shape:
        raise ValueError(
            f"`image` and `reference` must have one shape; got {first.shape} and {second.shape}."
        )
    # Premultiplied, since the colour of a transparent pixel is not visible.
    return premultiply(first.astype(np.float64)) - premultiply(second.astype(np.float64))


def _limit(limit: int | float | None, values: np.ndarray) -> float:
    """Return the limit of a colour scale, which is `limit` unless it is None.

    For None, it is the largest absolute value in `values`, or 1/255 if that is 0. Raises
    `ValueError` unless `limit` is positive and finite.
    """
    if limit is None:
        return float(np.abs(values).max()) or _EQUAL_LIMIT
    if not 0 < limit < np.inf:
        raise ValueError(f"`limit` must be positive; got {limit}.")
    return float(limit)


def _draw_map(
    values: np.ndarray,
    color_map: str,
    limits: tuple[float, float],
    label: str,
    axes: Axes | None,
    title: str,
) -> Axes:
    """Draw `values` `[height, width]` in a colour map, with a colour bar beside the plot.

    - `color_map`: matplotlib's name of the colour map.
    - `limits`: the values that get the first and the last colour of the colour map.
    - `label`: text beside the colour bar.
    - `axes`: axes to draw into; None for a new figure.
    - `title`: text above the plot.

    Returns the axes.
    """
    height, width = values.shape
    if axes is None:
        tall = float(np.clip(5 * height / width, 2, 8))
        _, axes = import_pyplot().subplots(figsize=(6.4, tall), layout="constrained")
        assert axes is not None
    picture = axes.imshow(
        values,
        cmap=color_map,
        vmin=limits[0],
        vmax=limits[1],
        extent=(0, width, height, 0),
        interpolation=fit_pixels(axes, height, width),
    )
    axes.set(xticks=[], yticks=[])
    if title:
        axes.set_title(title)
    # The ends of the colour bar are pointed if values lie beyond them.
    over, under = values.max() > limits[1], values.min() < limits[0]
    extend = "both" if over and under else "max" if over else "min" if under else "neither"
    bar = axes.figure.colorbar(picture, ax=axes, extend=extend, fraction=0.05, pad=0.02)
    bar.set_label(f"{label} (1 = full range)")
    return axes
