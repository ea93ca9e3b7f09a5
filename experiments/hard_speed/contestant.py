"""The interface of a renderer in the comparison; each renderer is one row of the tables."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Contestant:
    """A renderer that draws one scene.

    - `family`: name of the renderer: "softras2d", "scanline", "scalar loop" or a peer.
    - `sampling`: how pixels are averaged: "16 samples", "4x4 canvas", "anti-aliased".
    - `threads`: number of threads that the renderer may use.
    - `draw()` does the timed work and returns when it is done.
    - `image(drawn)` turns what `draw` returned into `[size, size, 3]` float32, untimed.
    """

    family: str
    sampling: str
    threads: int
    draw: Callable[[], object]
    image: Callable[[object], NDArray[np.float32]]

    @property
    def name(self) -> str:
        cores = f" ({self.threads} threads)" if self.threads > 1 else ""
        return f"{self.family}, {self.sampling}{cores}"
