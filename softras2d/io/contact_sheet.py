"""Arranges images with captions on one sheet."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import OpenImageIO as oiio
from jaxtyping import Float32

_MARGIN = 16
"""Space around images, in pixels."""

_TITLE_SIZE, _CAPTION_SIZE = 22, 15
"""Heights of text, in pixels."""

_PAPER = 0.96
"""Grey value of the sheet's background, in 0..1."""

_INK, _GREY = (0.1, 0.1, 0.12), (0.4, 0.4, 0.42)
"""Text colours, RGB in 0..1: of titles, and of notes and captions."""


class _Label(NamedTuple):
    """Text to draw on a sheet.

    - `left`, `baseline`: x and y of the start of the text on its baseline, in pixels.
    - `size`: height of the text, in pixels.
    - `color`: RGB in 0..1.
    """

    left: int
    baseline: int
    text: str
    size: int
    color: tuple[float, float, float]


class Strip(NamedTuple):
    """A row of images with text.

    - `title`, `note`: two lines of text above the row.
    - `captions`: the text below each image, one for each.
    - `images`: `[height, width, 3]` each, in 0..1, sRGB. Sizes may differ.
    """

    title: str
    note: str
    captions: Sequence[str]
    images: Sequence[np.ndarray]


def contact_sheet(
    strips: Sequence[Strip], *, across: int = 2
) -> Float32[np.ndarray, "height width 3"]:
    """Arrange strips on a light sheet, `across` strips side by side; returns its pixels, in 0..1.

    A strip is a row of images with a title and a note above it and captions below. Strips fill the
    sheet row by row. Images keep their size in pixels, and lie at the top left of their cells; all
    cells are as high as the highest image and as wide as the widest. OpenImageIO draws the text,
    with the font in its wheels; a build of OpenImageIO without FreeType leaves the text out. Raises
    `ValueError` if there is no image.
    """
    images = [image for strip in strips for image in strip.images]
    if not images:
        raise ValueError("a contact sheet needs at least one picture.")
    for strip in strips:
        assert len(strip.captions) == len(strip.images), f"{strip.title}: one caption per image"
    cell_height = max(image.shape[0] for image in images)
    cell_width = max(image.shape[1] for image in images)
    max_images = max(len(strip.images) for strip in strips)
    heading = _TITLE_SIZE + _CAPTION_SIZE + _MARGIN
    height = _MARGIN + heading + cell_height + _CAPTION_SIZE + _MARGIN
    width = 2 * _MARGIN + max_images * (cell_width + _MARGIN)
    rows = -(-len(strips) // across)
    sheet = np.full((rows * height + _MARGIN, across * width, 3), _PAPER, np.float32)
    labels = []
    for index, strip in enumerate(strips):
        top = (index // across) * height + _MARGIN
        left = (index % across) * width + _MARGIN
        title_line, note_line = top + _TITLE_SIZE, top + _TITLE_SIZE + _CAPTION_SIZE + 6
        labels.append(_Label(left, title_line, strip.title, _TITLE_SIZE, _INK))
        labels.append(_Label(left, note_line, strip.note, _CAPTION_SIZE, _GREY))
        top += heading
        for caption, image in zip(strip.captions, strip.images, strict=True):
            bottom = top + image.shape[0]
            sheet[top:bottom, left : left + image.shape[1]] = image
            caption_line = bottom + _CAPTION_SIZE + 3
            labels.append(_Label(left, caption_line, caption, _CAPTION_SIZE, _GREY))
            left += cell_width + _MARGIN
    return _draw_labels(sheet, labels)


def _draw_labels(
    sheet: Float32[np.ndarray, "height width 3"], labels: list[_Label]
) -> Float32[np.ndarray, "height width 3"]:
    """Return a copy of the sheet with `labels` drawn on it.

    A build of OpenImageIO without FreeType cannot draw text; the copy then has no labels.
    """
    height, width, channels = sheet.shape
    buffer = oiio.ImageBuf(oiio.ImageSpec(width, height, channels, oiio.FLOAT))
    buffer.set_pixels(oiio.ROI(0, width, 0, height), sheet)
    for left, baseline, text, size, color in labels:
        if not oiio.ImageBufAlgo.render_text(buffer, left, baseline, text, size, "", color):
            # Reading the error clears it; without FreeType, every label would fail.
            buffer.geterror()
            break
    return np.asarray(buffer.get_pixels(oiio.FLOAT))
