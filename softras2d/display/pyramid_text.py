"""Describes the textures of a mip pyramid on one line."""

from typing import Any

import numpy as np

from ..numerics.device import is_traced
from .leaves import dtype_of, field_of, size_of, values_of
from .words import count_text


def pyramid_text(textures: Any) -> str:
    """Describe a `TexturePyramid` on one line; never raises, whatever its leaves are.

    The line gives, as far as they are known, the numbers of textures, levels and channels, the
    largest size (or `traced`), the dtype, the border and the addressing.
    """
    texels, levels = field_of(textures, "texels"), field_of(textures, "levels")
    counts = [
        (size_of(levels, -3), "texture"),
        (size_of(levels, -2), "level"),
        (size_of(texels, -1), "channel"),
    ]
    facts = [count_text(count, noun) for count, noun in counts if count is not None]
    facts.append("traced" if is_traced([texels, levels]) else _size_text(values_of(levels)))
    facts += [dtype_of(texels), field_of(textures, "border"), field_of(textures, "addressing")]
    return f"TexturePyramid: {', '.join(str(fact) for fact in facts if fact)}"


def _size_text(levels: np.ndarray | None) -> str:
    """Text of the width and height of the texture with most texels, such as `64 x 32 texels`.

    With several textures, it begins with `largest`. It is empty if the sizes are not known.

    `levels`: the table of mip levels, `[textures, levels, 3]`, whose rows are offset, height and
    width.
    """
    if levels is None or levels.dtype.kind not in "iu" or not levels.size:
        return ""
    if levels.ndim < 3 or levels.shape[-1] != 3:
        return ""
    bases = levels[..., 0, 1:].reshape(-1, 2).astype(np.int64)
    height, width = bases[np.argmax(bases.prod(axis=1))].tolist()
    return f"{'largest ' if len(bases) > 1 else ''}{width} x {height} texels"
