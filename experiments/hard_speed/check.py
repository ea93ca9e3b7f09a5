"""Check the compiled loops against a few lines of numpy before anything is timed.

python -m experiments.hard_speed.check
"""

import numpy as np
from numpy.typing import NDArray

from ..common import scanline
from ..common.scenes import KINDS, Soup, random_soup
from . import scalar_loop
from .downsample import box

TOLERANCE = 2e-6


def by_definition(soup: Soup, rate: int) -> NDArray[np.float64]:
    """The image `[size, size, 3]` in float64, with every triangle tested at every sample."""
    side = soup.size * rate
    at = (np.arange(side) + 0.5) / rate
    x, y = np.meshgrid(at, at)
    samples = np.broadcast_to(soup.background, (side, side, 3)).astype(np.float64)
    for corners, colors in zip(soup.corners.astype(float), soup.colors.astype(float), strict=True):
        ends = np.roll(corners, -1, axis=0)
        # Edge k runs from corner k to corner k+1, opposite corner k+2.
        edges = [
            (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0])
            for p, q in zip(corners, ends, strict=True)
        ]
        area = edges[0] + edges[1] + edges[2]
        weights = np.stack([edges[1], edges[2], edges[0]], axis=-1) / area[..., None]
        rgba = weights @ colors
        alpha = np.where((weights >= 0).all(-1), rgba[..., 3], 0.0)[..., None]
        samples = (1 - alpha) * samples + alpha * rgba[..., :3]
    return samples.reshape(soup.size, rate, soup.size, rate, 3).mean(axis=(1, 3))


def main() -> None:
    """Raise `ValueError` at the first image that is wrong."""
    for kind in KINDS:
        soup = random_soup(40, 37, kind, seed=3)
        for rate in (1, 2, 4, 8):
            wanted = by_definition(soup, rate)
            for name, render in (("scanline", scanline.render), ("loop", scalar_loop.render)):
                for threads in (1, 2):
                    error = np.abs(render(soup, rate, threads) - wanted).max()
                    if error > TOLERANCE:
                        raise ValueError(
                            f"the {name} is off by {error:.2g} on {kind} at {rate}x{rate} samples "
                            f"with {threads} threads; at most {TOLERANCE:.0e} is accepted."
                        )
    canvas = np.random.default_rng(0).integers(0, 256, (40, 24, 4)).astype(np.uint8)
    for rate in (2, 4):
        tiles = canvas[..., :3].reshape(40 // rate, rate, 24 // rate, rate, 3)
        if not np.allclose(box(canvas, rate), tiles.mean(axis=(1, 3)) / 255, atol=1e-6):
            raise ValueError(f"the box filter is wrong at rate {rate}.")
    print("compiled loops and box filter agree with their definitions")


if __name__ == "__main__":
    main()
