"""The function `buffers`, which shows visibility buffers: triangle indices, weights, depth etc."""

from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Float32

from .library import AnyFigure, import_pyplot
from .palette import BACKGROUND, id_colors
from .strip import film_strip

_GREYS = (0.1, 1.0)
"""Grey levels, 0..1 in sRGB, of the farthest and of the nearest depth."""


@runtime_checkable
class Buffers(Protocol):
    """Visibility buffers that `buffers` can plot, such as the result of `rasterize`.

    - `triangle`: `[height, width, samples]`, the index of the triangle that each sample shows, or
      -1 where it shows the background.
    - `barycentric`: `[height, width, samples, 3]`, weights of the triangle's corners.
    - `depth`: `[height, width, samples]`, or None if the scene has none.
    - `coverage`: `[height, width]`, the fraction of the pixel that triangles cover, 0..1.

    The first three may have an axis of layers, nearest first, after the samples.

    An optional field `overdraw`, `[height, width, samples]` or None, is the number of triangles
    that cover each sample.
    """

    @property
    def triangle(self) -> Any: ...

    @property
    def barycentric(self) -> Any: ...

    @property
    def depth(self) -> Any: ...

    @property
    def coverage(self) -> Any: ...


class _Panel(NamedTuple):
    """One image of the figure that `buffers` draws, `[height, width, channels]`, and its title."""

    title: str
    image: Float[np.ndarray, "height width channels"]


def buffers(visible: Buffers, *, figure: AnyFigure | None = None) -> AnyFigure:
    """Show visibility buffers side by side; each pixel is the mean over its samples.

    - `visible`: the result of `rasterize`, or any object with the fields of `Buffers`. Of several
      layers, the nearest is shown.
    - `figure`: matplotlib figure to draw into; by default a new one.

    The panels are: triangle indices, in colours that differ clearly between neighbouring indices;
    barycentric weights of the corners 0, 1 and 2 as red, green and blue; depth, where nearer is
    lighter and the background is transparent; coverage, from black to white; and overdraw, from
    black to yellow. There is no panel of depth or overdraw if `visible` has none. Returns the
    figure. Raises `ValueError`, with a message of one line, for arrays whose shapes do not fit, and
    for an object without the fields, such as the result of `pixel_layers`.
    """
    import_pyplot()
    _check_fields(visible)
    triangle = np.asarray(visible.triangle)
    if triangle.ndim not in (3, 4):
        raise ValueError(f"`triangle` must be [height, width, samples]; got {triangle.shape}.")
    nearest = (slice(None),) * 3 + (0,) * (triangle.ndim - 3)
    numbers = triangle[nearest]
    is_covered, size = numbers >= 0, numbers.shape[:2]
    weights = _checked("barycentric", visible.barycentric, (*triangle.shape, 3))[nearest]
    coverage = _checked("coverage", visible.coverage, size)
    panels = [
        _Panel("triangle", id_colors(numbers)),
        _Panel("barycentric weights", _weight_colors(weights, is_covered)),
    ]
    if visible.depth is not None:
        depth = _checked("depth", visible.depth, triangle.shape)[nearest]
        panels.append(_depth_panel(depth, is_covered))
    panels.append(_Panel("coverage", coverage[..., None]))
    overdraw = getattr(visible, "overdraw", None)
    if overdraw is not None:
        panels.append(_overdraw_panel(_checked("overdraw", overdraw, numbers.shape)))
    return film_strip(
        [panel.image for panel in panels], titles=[panel.title for panel in panels], figure=figure
    )


def _check_fields(visible: Any) -> None:
    """Raise `ValueError` for an object that does not have all fields of `Buffers`."""
    fields = ("triangle", "barycentric", "depth", "coverage")
    if not all(hasattr(visible, field) for field in fields):
        raise ValueError(
            "`visible` must be the result of `rasterize`, or have the fields "
            f"{', '.join(fields[:-1])} and {fields[-1]}; got {type(visible).__name__}."
        )


def _checked(name: str, value: Any, shape: tuple[int, ...]) -> Float32[np.ndarray, "*shape"]:
    """Return `value` as float32. Raises `ValueError` if it does not have the given shape.

    `name`: name of the buffer, for the message.
    """
    array = np.asarray(value)
    if array.shape != shape:
        raise ValueError(f"`{name}` must be {list(shape)}, as `triangle`; got {list(array.shape)}.")
    return array.astype(np.float32)


def _weight_colors(
    weights: Float[np.ndarray, "height width samples 3"],
    is_covered: Bool[np.ndarray, "height width samples"],
) -> Float[np.ndarray, "height width 3"]:
    """Convert barycentric weights to RGB, averaged over the samples of a pixel.

    Samples that no triangle covers are light grey.
    """
    # Samples of the background may have any value, even NaN.
    colors = np.where(is_covered[..., None], np.nan_to_num(weights), np.float32(BACKGROUND))
    return np.clip(colors, 0, 1).mean(axis=2)


def _depth_panel(
    depth: Float[np.ndarray, "height width samples"],
    is_covered: Bool[np.ndarray, "height width samples"],
) -> _Panel:
    """Make the panel of depth: the mean depth of a pixel as grey, its covered fraction as alpha.

    `is_covered`: whether a triangle covers each sample. Other samples, and those whose depth is not
    finite, do not count. The nearest pixels are the lightest.
    """
    is_known = is_covered & np.isfinite(depth)
    count = is_known.sum(axis=2)
    alpha = count / is_known.shape[2]
    total = np.where(is_known, depth, 0.0).sum(axis=2)
    mean = total / np.maximum(count, 1)
    if not is_known.any():
        return _Panel("depth", np.zeros((*mean.shape, 4)))
    near, far = float(mean[count > 0].min()), float(mean[count > 0].max())
    darkest, lightest = _GREYS
    distance = (mean - near) / (far - near or 1.0)
    grey = np.clip(lightest + (darkest - lightest) * distance, 0, 1)
    return _Panel(
        f"depth: {near:.3g} (light) to {far:.3g}", np.stack([grey, grey, grey, alpha], axis=-1)
    )


def _overdraw_panel(overdraw: Float[np.ndarray, "height width samples"]) -> _Panel:
    """Make the panel of overdraw: the mean number of triangles that cover a sample of each pixel.

    The colour map begins with black, for 0, and ends with yellow, for the largest mean. A negative
    value of `overdraw`, which means that it is not known, counts as 0.
    """
    # Overdraw of -1 is not known, as the scene outgrew its plan.
    mean = np.maximum(overdraw, 0).mean(axis=2)
    largest = float(mean.max())
    colors = import_pyplot().colormaps["inferno"](mean / (largest or 1.0))
    return _Panel(f"overdraw: 0 to {largest:.3g}", np.asarray(colors)[..., :3])
