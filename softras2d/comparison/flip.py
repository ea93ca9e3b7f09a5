"""Mean FLIP, an estimate of how visible a difference is when two images alternate on a screen.

It is computed by NVIDIA's `flip-evaluator`, an optional dependency.

**Source:** Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström and Fairchild, *FLIP: A Difference
Evaluator for Alternating Images* (Proc. ACM CGIT 3(2), 2020).
"""

import numpy as np
from jaxtyping import Float

from .pixels import on_white

INSTALL = 'pip install "softras2d[compare]"'
"""Command that installs `flip-evaluator`."""


def mean_flip(
    image: Float[np.ndarray, "height width channels"],
    reference: Float[np.ndarray, "height width channels"],
) -> float:
    """Compute the mean FLIP, in 0..1, of two premultiplied images in sRGB; 0 for equal images.

    The assumed screen is the evaluator's default, with 67 pixels per degree of visual angle. Images
    with alpha are composited over white, and values are clipped to 0..1. Raises `ImportError`, with
    a message of one line, if `flip-evaluator` is missing.
    """
    try:
        import flip_evaluator
    except ImportError as missing:
        raise ImportError(f"FLIP needs flip-evaluator: {INSTALL} ({missing}).") from missing
    _, mean, _ = flip_evaluator.evaluate(
        on_white(reference), on_white(image), "LDR", applyMagma=False
    )
    return float(mean)
