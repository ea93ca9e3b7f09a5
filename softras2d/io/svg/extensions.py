"""Draws images, and the course's elements `colortri` and `textri`, in the dialect `svg`.

An error in one of these two is raised, since no other program writes them. An image that cannot be
read is left out, as browsers do.
"""

import math

import numpy as np
from jaxtyping import Float

from ...geometry import affine_maps
from ..budget import BudgetError
from ..shapes.regions import intersection, is_empty
from .document import Attributes
from .layers import Item
from .notices import INVALID, NOT_DRAWN
from .numbers import number_list
from .page import Page
from .painting import Place, is_clipped
from .shape_elements import ElementLengths
from .sinks import Textured, textured_items, triangle_items
from .style import Style
from .tree import Element
from .view_box import Box, fit


def draw_colortri(
    page: Page,
    element: Element,
    lengths: ElementLengths,
    place: Place,
    style: Style,
    opacity: float,
) -> None:
    """Draw a triangle with a colour for each corner."""
    attributes = element.attrib
    points = _numbers(attributes, "points", 6).reshape(3, 2)
    colors = _numbers(attributes, "colors", 12).reshape(3, 4)
    if not ((colors[:, 3] >= 0) & (colors[:, 3] <= 1)).all():
        raise ValueError(f"colors: alpha must be in 0..1, got {attributes['colors']!r}.")
    if page.context.opacity:
        colors[:, 3] *= style.fill_opacity * opacity
    else:
        colors[:, 3] = 1.0
    corners = affine_maps.apply(place.map3, points)
    if is_clipped(place.clip, corners):
        _add_clipped(page, place, triangle_items(corners, colors))
    else:
        place.sink.add_triangle(corners, colors)


def draw_textri(
    page: Page,
    element: Element,
    lengths: ElementLengths,
    place: Place,
    style: Style,
    opacity: float,
) -> None:
    """Draw a triangle with a texture."""
    attributes = element.attrib
    points = _numbers(attributes, "points", 6).reshape(3, 2)
    uv = _numbers(attributes, "uvs", 6).reshape(3, 2)
    assets = page.context.assets
    texture = assets.texture(attributes.get("texid", ""))
    alpha = style.fill_opacity * opacity if page.context.opacity else 1.0
    translucent = alpha < 1 or assets.textures[texture].shape[-1] == 4
    corners = affine_maps.apply(place.map3, points)
    _add_textured(page, place, Textured(corners, (1.0, 1.0, 1.0, alpha), uv, texture, translucent))


def draw_image(
    page: Page,
    element: Element,
    lengths: ElementLengths,
    place: Place,
    style: Style,
    opacity: float,
) -> None:
    """Draw an image file as a texture (SVG 2, section 12.3)."""
    href = element.attrib.get("href")
    if href is None:
        lengths.report(INVALID, "href", "image without href")
        return
    assets = page.context.assets
    try:
        texture = assets.linked(href)
    except BudgetError:
        raise
    except ValueError as error:
        lengths.report(NOT_DRAWN, "href", str(error))
        return
    picture_height, picture_width = map(float, assets.textures[texture].shape[:2])
    width, height = lengths.read("width", math.inf), lengths.read("height", math.inf)
    for name, side in (("width", width), ("height", height)):
        if side < 0:
            lengths.report(INVALID, name, "must not be negative")
    if width <= 0 or height <= 0:
        return
    # Infinity stands for `auto`: the side follows from the picture.
    if width == math.inf:
        is_auto = height == math.inf
        width = picture_width if is_auto else height * picture_width / picture_height
    if height == math.inf:
        height = width * picture_height / picture_width
    box = Box(0.0, 0.0, picture_width, picture_height)
    try:
        to_viewport = fit(box, height, width, element.attrib.get("preserveAspectRatio", ""))
    except ValueError as error:
        lengths.report(INVALID, "preserveAspectRatio", str(error))
        to_viewport = fit(box, height, width)
    # With `slice`, the picture reaches beyond the viewport, which clips it. Texture coordinates
    # are fractions of the picture.
    low, high = affine_maps.apply(to_viewport, [[0.0, 0.0], [picture_width, picture_height]])
    start, end = np.maximum(low, 0.0), np.minimum(high, [width, height])
    uv = _box_corners(Box(*((start - low) / (high - low)), *((end - start) / (high - low))))
    origin = np.array([lengths.read("x"), lengths.read("y")])
    points = affine_maps.apply(place.map3, _box_corners(Box(*(origin + start), *(end - start))))
    # `fill-opacity` does not apply to images.
    alpha = opacity if page.context.opacity else 1.0
    translucent = alpha < 1 or assets.textures[texture].shape[-1] == 4
    white = (1.0, 1.0, 1.0, alpha)
    _add_textured(page, place, Textured(points, white, uv, texture, translucent))


def _add_textured(page: Page, place: Place, textured: Textured) -> None:
    if is_clipped(place.clip, textured.points):
        _add_clipped(page, place, textured_items(textured))
    else:
        place.sink.add_textured(textured)


def _add_clipped(page: Page, place: Place, items: list[Item]) -> None:
    for item in items:
        region = intersection(item.region, place.clip, page.budget)
        if not is_empty(region):
            place.sink.add_items([item._replace(region=region)])


def _numbers(attributes: Attributes, name: str, count: int) -> Float[np.ndarray, " {count}"]:
    """Parse an attribute of exactly `count` numbers."""
    try:
        numbers = number_list(attributes.get(name, ""))
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if len(numbers) != count:
        raise ValueError(f"{name}: expected {count} numbers, got {len(numbers)}.")
    return np.array(numbers)


def _box_corners(box: Box) -> Float[np.ndarray, "4 2"]:
    """Corners in the order top left, top right, bottom right, bottom left."""
    x, y = box.x, box.y
    return np.array(
        [[x, y], [x + box.width, y], [x + box.width, y + box.height], [x, y + box.height]]
    )
