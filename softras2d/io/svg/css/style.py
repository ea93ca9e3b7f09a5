"""Defines the computed style of an element, and the paints that it may have."""

from typing import Any, NamedTuple

from ..values.css_color import Rgba
from ..values.units import MEDIUM

BLACK: Rgba = (0.0, 0.0, 0.0, 1.0)


class PaintServer(NamedTuple):
    """A paint that refers to a gradient or pattern, as in `url(#id) red`.

    - `reference`: the text between the parentheses, such as `#id`, without quotes.
    - `fallback`: the paint after the reference, which is used if the reference leads to no gradient
      that can be applied: a colour, `CURRENT` for `currentColor`, or None for `none`. False if no
      fallback is given.
    """

    reference: str
    fallback: Rgba | str | bool | None = False


Paint = Rgba | str | PaintServer | None
"""A colour, `CURRENT` for `currentColor`, a reference to a paint server, or None for no paint."""


class Style(NamedTuple):
    """Computed style of an element. Fields are named after CSS properties.

    `opacity` and the fields after it are not inherited. Lengths are in user units, and opacities
    are in 0..1.

    - `color`, `stop_color`, `background_color`: an `Rgba`, which is sRGB with straight alpha. The
      last two may also be `CURRENT`, which stands for `color`.
    - `stroke_dasharray`: an even number of lengths; empty for a solid line.
    - `paint_order`: `"fill"` and `"stroke"`, in the order in which they are painted.
    - `overflow`: empty if it is not declared; it may have two keywords, for x and y.
    - `clip_path`: text of the property, such as `url(#id)`; None for `none`.
    - `transform_origin`: text of the property.
    """

    fill: Paint = BLACK
    stroke: Paint = None
    color: Any = BLACK
    fill_opacity: float = 1.0
    stroke_opacity: float = 1.0
    fill_rule: str = "nonzero"
    clip_rule: str = "nonzero"
    stroke_width: float = 1.0
    stroke_linecap: str = "butt"
    stroke_linejoin: str = "miter"
    stroke_miterlimit: float = 4.0
    stroke_dasharray: tuple[float, ...] = ()
    stroke_dashoffset: float = 0.0
    paint_order: tuple[str, ...] = ("fill", "stroke")
    visibility: str = "visible"
    font_size: float = MEDIUM
    opacity: float = 1.0
    display: str = "inline"
    overflow: str = ""
    vector_effect: str = "none"
    clip_path: str | None = None
    transform_origin: str = "0 0"
    transform_box: str = "view-box"
    stop_color: Any = BLACK
    stop_opacity: float = 1.0
    background_color: Any = (0.0, 0.0, 0.0, 0.0)


INITIAL = Style()
"""The initial value of every property."""

NOT_INHERITED = INITIAL._asdict()
for _name in Style._fields[: Style._fields.index("opacity")]:
    del NOT_INHERITED[_name]
