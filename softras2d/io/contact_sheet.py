"""Arranges images with captions on one sheet."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import OpenImageIO as oiio
from jaxtyping import Float32

_MARGIN = 16
"""Space around images, in pixels."""

_TITLE, _CAPTION = 22, 15
"""Heights of text, in pixels."""

_PAPER, _INK, _GREY = 0.96, (0.1, 0.1, 0.12), (0.4, 0.4, 0.42)


class Strip(NamedTuple):
    """A title and a note over pictures `[height, width, 3]` in 0..1, each over its caption."""

    title: str
    note: str
    captions: Sequence[str]
    images: Sequence[np.ndarray]


def contact_sheet(strips: Sequence[Strip], *, across: int = 2) -> Float32[np.ndarray, "h w 3"]:
    """All `strips`, `across` of them beside each other, on light paper.

    Pictures keep their pixels; a cell is as large as the largest of them. Type is drawn by
    OpenImageIO, with the font that its wheels bring; a build without FreeType leaves it out.
    Raises `ValueError` if there is nothing to show.
    """
    images = [image for strip in strips for image in strip.images]
    if not images:
        raise ValueError("a contact sheet needs at least one picture.")
    cell_height = max(image.shape[0] for image in images)
    cell_width = max(image.shape[1] for image in images)
    most = max(len(strip.images) for strip in strips)
    heading = _TITLE + _CAPTION + _MARGIN
    height = _MARGIN + heading + cell_height + _CAPTION + _MARGIN
    width = 2 * _MARGIN + most * (cell_width + _MARGIN)
    rows = -(-len(strips) // across)
    sheet = np.full((rows * height + _MARGIN, across * width, 3), _PAPER, np.float32)
    labels = []
    for index, strip in enumerate(strips):
        top = (index // across) * height + _MARGIN
        left = (index % across) * width + _MARGIN
        labels.append((left, top + _TITLE, strip.title, _TITLE, _INK))
        labels.append((left, top + _TITLE + _CAPTION + 6, strip.note, _CAPTION, _GREY))
        top += heading
        for caption, image in zip(strip.captions, strip.images, strict=True):
            bottom = top + image.shape[0]
            sheet[top:bottom, left : left + image.shape[1]] = image
            labels.append((left, bottom + _CAPTION + 3, caption, _CAPTION, _GREY))
            left += cell_width + _MARGIN
    return _lettered(sheet, labels)


def _lettered(sheet: np.ndarray, labels: list) -> np.ndarray:
    """`sheet` with `(left, baseline, text, size, colour)` written on it."""
    height, width, channels = sheet.shape
    buffer = oiio.ImageBuf(oiio.ImageSpec(width, height, channels, oiio.FLOAT))
    buffer.set_pixels(oiio.ROI(0, width, 0, height), sheet)
    for left, baseline, text, size, color in labels:
        if not oiio.ImageBufAlgo.render_text(buffer, left, baseline, text, size, "", color):
            buffer.geterror()
            break
    return np.asarray(buffer.get_pixels(oiio.FLOAT))
