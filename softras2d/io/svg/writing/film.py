"""Writes films, which are sequences of scenes, as animated SVG files that browsers play."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int

from ....scene import Scene
from ...drafts import atomic_file
from ...outputs import check_writable_path
from .arguments import check_canvas, check_digits, check_scene
from .short_numbers import join_numbers, short_color, to_units, unit_text


def write_svg_film(
    path: str | os.PathLike[str],
    scenes: Sequence[Scene],
    *,
    height: int,
    width: int,
    seconds_per_frame: int | float = 0.1,
    digits: int = 1,
    smooth: bool = False,
) -> None:
    """Write the scenes of a film, such as the results of `fit_frames`, as an SVG that repeats.

    Each triangle is a `<polygon>` whose corners and colour are changed by SMIL animations. The
    background is a `<rect>` below the triangles, which is animated too. What stays the same in all
    frames is not animated.

    - `scenes`: one for each frame, with equal numbers of triangles, of colours per triangle, and of
      channels of colours and of backgrounds. Triangle k of all scenes is the same triangle at
      different times. Colours are flat: a triangle with corner colours is written in their mean.
    - `height`, `width`: size of the canvas, in pixels.
    - `seconds_per_frame`: duration of the film divided by the number of frames, above 0.
    - `digits`: decimals to which coordinates are rounded, 0 to 6. Colours are clipped to 0..1 and
      rounded to 8 bits, and alpha to 1/1000.
    - `smooth`: whether corners and colours change evenly from frame to frame, instead of jumping.
      They still jump from the last frame to the first.

    The file is written completely or not at all. Raises `ValueError`, one line, for no scenes,
    scenes whose numbers of triangles, colours or channels differ, scenes with textures, `depth` or
    `inverse_w`, values that cannot be written, and a file that cannot be written.
    """
    path = Path(path)
    check_writable_path(path)
    if not scenes:
        raise ValueError(f"{path}: there are no frames; a film needs at least one.")
    is_number = isinstance(seconds_per_frame, int | float | np.number)
    if not is_number or not 0 < seconds_per_frame < float("inf"):
        raise ValueError(
            f"`seconds_per_frame` must be a number above 0; got {seconds_per_frame!r:.60}."
        )
    check_digits(digits)
    check_canvas(height, width)
    for number, scene in enumerate(scenes):
        try:
            check_scene(scene, absent=("textures", "depth", "inverse_w"))
        except ValueError as error:
            raise ValueError(f"{path}: frame {number}: {error}") from None
    shapes = {
        (scene.triangles.shape, scene.colors.shape, scene.background.shape) for scene in scenes
    }
    if len(shapes) != 1:
        raise ValueError(
            f"{path}: the arrays of all scenes must have equal shapes; got {len(shapes)} shapes."
        )
    corners = np.stack([np.asarray(s.positions)[np.asarray(s.triangles)] for s in scenes])
    colors = np.stack([np.asarray(s.colors).mean(1) for s in scenes])
    backgrounds = np.stack([np.asarray(s.background) for s in scenes])
    timing = _timing(len(scenes) * seconds_per_frame, smooth)
    units = to_units(corners, digits)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}">',
        _shape("rect", [f'width="{width}" height="{height}"'], _paint_values(backgrounds), timing),
        *(_polygon(units[:, k], digits, colors[:, k], timing) for k in range(corners.shape[1])),
        "</svg>\n",
    ]
    with atomic_file(path) as draft:
        draft.write_text("\n".join(lines), encoding="utf-8")


def _timing(seconds: float, smooth: bool) -> str:
    """The attributes that all `<animate>` elements share: duration, repetition and interpolation.

    `seconds` is the duration of the whole film. Values jump from frame to frame unless `smooth`.
    """
    mode = "" if smooth else ' calcMode="discrete"'
    return f'dur="{seconds:.6g}s" repeatCount="indefinite"{mode}'


def _polygon(
    units: Int[np.ndarray, "frames 3 2"], digits: int, colors: np.ndarray, timing: str
) -> str:
    """The element of an animated triangle.

    - `units`: its corners in each frame, in units of 10^-digits pixels.
    - `colors`: its colour in each frame, `[frames, 3 or 4]`.
    - `timing`: the attributes that `_timing` returns.
    """
    points = [join_numbers([unit_text(n, digits) for n in row.ravel().tolist()]) for row in units]
    return _shape("polygon", [], {"points": points} | _paint_values(colors), timing)


def _paint_values(colors: np.ndarray) -> dict[str, list[str]]:
    """For each paint attribute, its value in each frame, from colours `[frames, 3 or 4]`.

    The attributes are `fill`, and `fill-opacity` only if a frame is translucent. Colours are
    clipped to 0..1 and rounded to 8 bits, and alpha to three decimals.
    """
    values = {"fill": [short_color(color[:3]) for color in colors]}
    if colors.shape[1] == 4 and (colors[:, 3] < 1).any():
        alphas = [round(1000 * min(max(float(color[3]), 0.0), 1.0)) for color in colors]
        values["fill-opacity"] = [unit_text(alpha, 3) for alpha in alphas]
    return values


def _shape(
    name: str, fixed_attributes: list[str], values: dict[str, list[str]], timing: str
) -> str:
    """The text of an element with the attributes of the first frame, and animations of the changes.

    An attribute that is equal in all frames is not animated.

    - `name`: name of the element.
    - `fixed_attributes`: attributes that do not change, as text.
    - `values`: for each attribute that may change, its value in each frame.
    - `timing`: the attributes that `_timing` returns.
    """
    attributes = [*fixed_attributes, *(f'{key}="{v[0]}"' for key, v in values.items())]
    animations = [
        f'<animate attributeName="{key}" {timing} values="{";".join(value_of_frame)}"/>'
        for key, value_of_frame in values.items()
        if len(set(value_of_frame)) > 1
    ]
    start = f"<{name} {' '.join(attributes)}"
    return f"{start}>{''.join(animations)}</{name}>" if animations else f"{start}/>"
