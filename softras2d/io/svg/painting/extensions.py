"""Draws images, and the course's elements `colortri` and `textri`, in the dialect `svg`.

An error in a `colortri` or `textri` is raised, since only this project writes these elements. An
image that cannot be read is left out, as in browsers.
"""

import numpy as np
from jaxtyping import Float

from ....geometry import affine_maps
from ...budget import BudgetError
from ...shapes.regions import intersection, is_empty
from ..canvas.layers import Item
from ..canvas.placement import Placement
from ..canvas.sinks import Textured, textured_items, triangle_items
from ..css.style import Style
from ..elements.image_size import image_size
from ..elements.page import Page
from ..elements.shape_elements import ElementLengths
from ..elements.view_box import Box, fit
from ..values.numbers import number_list
from ..xml.document import Attributes
from ..xml.notices import INVALID, NOT_DRAWN
from ..xml.tree import Element


def draw_extension(
    page: Page,
    element: Element,
    lengths: ElementLengths,
    placement: Placement,
    style: Style,
    opacity: float,
) -> None:
    """Draw an `image`, a `colortri` or a `textri`.

    - `lengths`: reads the attributes of an `image`.
    - `placement`: map to pixels, clip, and sink of the result.
    - `style`: computed style of the element.
    - `opacity`: the element's `opacity`, in 0..1. For a `colortri` or `textri`, it is multiplied by
      `fill-opacity`. If the reader does not apply opacities, both are ignored.

    The caller tests `visibility`. Raises `ValueError` for an invalid attribute of a `colortri` or
    `textri`, for a corner that the map sends to infinity or beyond (w <= 0), and for work beyond
    the budget. An image that cannot be read is left out and noted.
    """
    if element.name == "image":
        # `fill-opacity` does not apply to images.
        _draw_image(page, element, lengths, placement, opacity)
    else:
        _draw_triangle(page, element, placement, style.fill_opacity * opacity)


def _draw_triangle(page: Page, element: Element, placement: Placement, opacity: float) -> None:
    """Draw a `colortri`, with a colour for each corner, or a `textri`, with a texture.

    `opacity` is a factor of the alpha, in 0..1. Everything is opaque if the reader does not apply
    opacities. Errors are as for `draw_extension`.
    """
    attributes = element.attrib
    points = _numbers(attributes, "points", 6).reshape(3, 2)
    corners = affine_maps.apply(placement.map3, points)
    if element.name == "textri":
        uv = _numbers(attributes, "uvs", 6).reshape(3, 2)
        texture = page.context.assets.texture(attributes.get("texid", ""))
        _add_textured(page, placement, corners, uv, texture, opacity)
        return
    colors = _numbers(attributes, "colors", 12).reshape(3, 4)
    if not ((colors[:, 3] >= 0) & (colors[:, 3] <= 1)).all():
        raise ValueError(f"colors: alpha must be in 0..1, got {attributes['colors']!r}.")
    colors[:, 3] = colors[:, 3] * opacity if page.context.opacity else 1.0
    if placement.may_clip(corners):
        _add_clipped(page, placement, triangle_items(corners, colors))
    else:
        placement.sink.add_triangle(corners, colors)


def _draw_image(
    page: Page,
    element: Element,
    lengths: ElementLengths,
    placement: Placement,
    opacity: float,
) -> None:
    """Draw an `image` as a rectangle with a texture (SVG 2, section 12.3).

    `opacity` is a factor of the texture's alpha, in 0..1. An image without `href`, one that cannot
    be read, and a negative side are noted. Such an image is not drawn, and neither is one with a
    side of 0.
    """
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
    height, width = image_size(page, element, lengths)
    if width <= 0 or height <= 0:
        return
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
    corners = _box_corners(Box(*(origin + start), *(end - start)))
    points = affine_maps.apply(placement.map3, corners)
    _add_textured(page, placement, points, uv, texture, opacity)


def _add_textured(
    page: Page,
    placement: Placement,
    points: Float[np.ndarray, "n 2"],
    uv: Float[np.ndarray, "n 2"],
    texture: int,
    opacity: float,
) -> None:
    """Add a convex polygon with a texture to the sink of a placement, clipped to its clip.

    - `points`, `uv`: vertices in pixels, and their texture coordinates (u right, v down, 0..1
      across the texture). If the clip may cut the polygon, those of the first three vertices
      determine the rest, and a polygon whose first three vertices span no area is not drawn.
    - `texture`: index in `Assets.textures`.
    - `opacity`: factor of the texture's alpha, in 0..1, which counts as 1 if the reader does not
      apply opacities.
    """
    alpha = opacity if page.context.opacity else 1.0
    translucent = alpha < 1 or page.context.assets.textures[texture].shape[-1] == 4
    textured = Textured(points, (1.0, 1.0, 1.0, alpha), uv, texture, translucent)
    if placement.may_clip(points):
        _add_clipped(page, placement, textured_items(textured))
    else:
        placement.sink.add_textured(textured)


def _add_clipped(page: Page, placement: Placement, items: list[Item]) -> None:
    """Clip regions with paints to the clip of the placement, and add what is left to its sink.

    The placement must have a clip.
    """
    for item in items:
        region = intersection(item.region, placement.clip, page.budget)
        if not is_empty(region):
            placement.sink.add_items([item._replace(region=region)])


def _numbers(attributes: Attributes, name: str, count: int) -> Float[np.ndarray, " {count}"]:
    """Parse the attribute `name`, which must consist of exactly `count` numbers.

    Raises `ValueError` for any other text.
    """
    try:
        numbers = number_list(attributes.get(name, ""))
    except ValueError as error:
        raise ValueError(f"{name}: {error}") from None
    if len(numbers) != count:
        raise ValueError(f"{name}: expected {count} numbers, got {len(numbers)}.")
    return np.array(numbers)


def _box_corners(box: Box) -> Float[np.ndarray, "4 2"]:
    """The corners (x, y) of a box, in the order top left, top right, bottom right, bottom left."""
    x, y = box.x, box.y
    return np.array(
        [[x, y], [x + box.width, y], [x + box.width, y + box.height], [x, y + box.height]]
    )
