"""Computes the size of `image` elements, which may depend on the picture."""

import math

from ...budget import BudgetError
from ..xml.notices import INVALID
from ..xml.tree import Element
from .page import Page
from .shape_elements import ElementLengths


def image_size(page: Page, element: Element, lengths: ElementLengths) -> tuple[float, float]:
    """The (height, width) of an `image`, in user units.

    `lengths` reads the attributes of the image. A side that is missing or `auto` follows from the
    other side and the aspect ratio of the picture. If both sides are missing or `auto`, the size is
    that of the picture, whose pixels count as user units. If the picture cannot be read, a side
    that is missing or `auto` is 0. A negative side is noted and counts as 0. Raises `BudgetError`
    for a picture that is too large.

    **Source:** SVG 2, section 12.3.
    """
    # Infinity stands for `auto`.
    height, width = lengths.read("height", math.inf), lengths.read("width", math.inf)
    for name, side in (("height", height), ("width", width)):
        if side < 0:
            lengths.report(INVALID, name, "must not be negative")
    height, width = max(height, 0.0), max(width, 0.0)
    if math.inf in (height, width):
        picture_height, picture_width = _picture_size(page, element)
        if height == width == math.inf:
            return picture_height, picture_width
        if width == math.inf:
            width = height * picture_width / max(picture_height, 1.0)
        else:
            height = width * picture_height / max(picture_width, 1.0)
    return height, width


def _picture_size(page: Page, element: Element) -> tuple[float, float]:
    """The (height, width) of the picture of an `image`, in pixels; (0, 0) if it cannot be read.

    Raises `BudgetError` for a picture that is too large.
    """
    try:
        height, width = page.context.assets.picture(element.attrib.get("href", "")).shape[:2]
    except BudgetError:
        raise
    except ValueError:
        # Drawing the image notes this.
        return 0.0, 0.0
    return float(height), float(width)
