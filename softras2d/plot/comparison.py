"""Shows how an image differs from a reference."""

from typing import Any

import numpy as np

from ..color import premultiply
from .library import Axes, import_pyplot
from .picture import checked_image, fit_pixels

_LEAST = 1 / 255
"""The limit for images that are equal: a step of eight bits."""


def difference(
    image: Any,
    reference: Any,
    *,
    axes: Axes | None = None,
    limit: int | float | None = None,
    title: str = "",
) -> Axes:
    """Show `image - reference`, the mean over channels: red where `image` is brighter, else blue.

    Both are `[height, width, 1, 3 or 4]` of one shape; colours of four channels count as
    premultiplied. Differences of opposite signs in two channels cancel, which `error` shows.
    Colours reach from `-limit` to `limit`, by default the largest absolute value; 1 is the whole
    range. Raises `ValueError`, one line, for images of other or unequal shapes, NaN and infinity,
    and a `limit` that is not positive.
    """
    values = _difference(image, reference).mean(axis=-1)
    limit = _limit(limit, values)
    label = "image - reference"
    return _map(values, "RdBu_r", (-limit, limit), label, axes, title)


def error(
    image: Any,
    reference: Any,
    *,
    axes: Axes | None = None,
    limit: int | float | None = None,
    title: str = "",
) -> Axes:
    """Show the error of each pixel: the root of the mean of squared differences over channels.

    Both are `[height, width, 1, 3 or 4]` of one shape; colours of four channels count as
    premultiplied. Colours reach from 0 to `limit`, by default the largest value; 1 is the whole
    range. Raises `ValueError` as `difference` does.
    """
    values = np.sqrt(np.square(_difference(image, reference)).mean(axis=-1))
    limit = _limit(limit, values)
    return _map(values, "viridis", (0.0, limit), "RMSE", axes, title)


def _difference(image: Any, reference: Any) -> np.ndarray:
    first, second = checked_image("`image`", image), checked_image("`reference`", reference)
    if first.shape != second.shape:
        raise ValueError(
            f"`image` and `reference` must have one shape; got {first.shape} and {second.shape}."
        )
    # The colour of a transparent pixel does not show.
    return premultiply(first.astype(np.float64)) - premultiply(second.astype(np.float64))


def _limit(limit: int | float | None, values: np.ndarray) -> float:
    if limit is None:
        return float(np.abs(values).max()) or _LEAST
    if not 0 < limit < np.inf:
        raise ValueError(f"`limit` must be positive; got {limit}.")
    return float(limit)


def _map(
    values: np.ndarray,
    colors: str,
    limits: tuple[float, float],
    label: str,
    axes: Axes | None,
    title: str,
) -> Axes:
    """`values` `[height, width]` as colours, with a bar that says which."""
    height, width = values.shape
    if axes is None:
        tall = float(np.clip(5 * height / width, 2, 8))
        _, axes = import_pyplot().subplots(figsize=(6.4, tall), layout="constrained")
        assert axes is not None
    picture = axes.imshow(
        values,
        cmap=colors,
        vmin=limits[0],
        vmax=limits[1],
        extent=(0, width, height, 0),
        interpolation=fit_pixels(axes, height, width),
    )
    axes.set(xticks=[], yticks=[])
    if title:
        axes.set_title(title)
    over, under = values.max() > limits[1], values.min() < limits[0]
    extend = "both" if over and under else "max" if over else "min" if under else "neither"
    bar = axes.figure.colorbar(picture, ax=axes, extend=extend, fraction=0.05, pad=0.02)
    bar.set_label(f"{label} (1 = full range)")
    return axes
