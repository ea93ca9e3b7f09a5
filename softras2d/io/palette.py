"""Reduces images to 256 colours."""

import heapq

import numpy as np
from jaxtyping import Float, Int, UInt8

COLORS = 256
"""Maximum number of colours of a palette."""


def quantized(
    image: UInt8[np.ndarray, "height width 3"],
) -> tuple[UInt8[np.ndarray, "height width"], UInt8[np.ndarray, "colors 3"]]:
    """Reduce an image to at most 256 colours; returns palette indices of pixels, and the palette.

    If the image has at most 256 colours, the result is exact. Otherwise each colour of the palette
    is the rounded mean of the pixels that use it. There is no dithering, which would make still
    parts of an animation flicker and its file larger.
    """
    codes = image.astype(np.uint32) @ np.array([1 << 16, 1 << 8, 1], np.uint32)
    codes, color_of_pixel, counts = np.unique(codes, return_inverse=True, return_counts=True)
    colors = np.stack([codes >> 16, codes >> 8 & 255, codes & 255], axis=1).astype(np.float64)
    boxes = np.arange(len(colors))
    if len(colors) > COLORS:
        boxes = _boxes(colors, counts)
    sums = [np.bincount(boxes, counts * channel) for channel in colors.T]
    palette = np.stack(sums, axis=1) / np.bincount(boxes, counts)[:, None]
    indices = boxes.astype(np.uint8)[color_of_pixel].reshape(image.shape[:2])
    return indices, np.rint(palette).astype(np.uint8)


def _boxes(colors: Float[np.ndarray, "n 3"], counts: Int[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
    """Group more than 256 distinct colours into 256 boxes; returns the index of each colour's box.

    `counts` are the numbers of pixels of the colours. Starting with one box, the box with the
    largest squared error from its mean colour, summed over its pixels, is cut in two: at its mean,
    across the channel with the largest error. Boxes are chosen by their error and not by their
    number of pixels, so that a few red pixels on a white background stay red.

    **Source:** variant of median cut, Heckbert, *Color Image Quantization for Frame Buffer Display*
    (SIGGRAPH 1982).
    """
    boxes = np.zeros(len(colors), np.int64)
    heap = [_heap_entry(0, np.arange(len(colors)), colors, counts)]
    for new in range(1, COLORS):
        _, box, members, channel, mean = heapq.heappop(heap)
        above = colors[members, channel] > mean
        boxes[members[above]] = new
        heapq.heappush(heap, _heap_entry(box, members[~above], colors, counts))
        heapq.heappush(heap, _heap_entry(new, members[above], colors, counts))
    return boxes


def _heap_entry(
    box: int, members: np.ndarray, colors: np.ndarray, counts: np.ndarray
) -> tuple[float, int, np.ndarray, int, float]:
    """Make the heap entry of a box of colours; the box with the largest squared error comes first.

    - `box`: index of the box.
    - `members`: indices in `colors` of the colours in the box.
    - `colors`, `counts`: all colours, and the number of pixels of each.

    Returns minus the squared error, summed over pixels; `box`; `members`; the channel with the
    largest error, across which to cut the box; and the mean of that channel, at which to cut.
    """
    member_colors, weights = colors[members], counts[members]
    means = weights @ member_colors / weights.sum()
    errors = weights @ (member_colors - means) ** 2
    channel = int(np.argmax(errors))
    return -float(errors.sum()), box, members, channel, float(means[channel])
