"""softras2d and the compiled loops as renderers of the comparison."""

import os

import numpy as np

from ..common import scanline
from ..common.scenes import Soup
from . import scalar_loop
from .contestant import Contestant

CORES = os.cpu_count() or 1


def softras2d(soup: Soup, samples: int) -> Contestant:
    """Time `render` in hard mode, until the image is ready, with a plan made beforehand.

    Binning is part of `render`; the plan only has capacities. The scene stores as few colours as
    possible: one per triangle if flat, and three channels if opaque.
    """
    import softras2d as sr

    scene = package_scene(soup)
    plan = sr.plan(scene, height=soup.size, width=soup.size, coverage=sr.Hard(samples=samples))
    return Contestant(
        "softras2d",
        _label(samples),
        CORES,
        lambda: sr.render(scene, plan).block_until_ready(),
        np.asarray,
    )


def package_scene(soup: Soup):
    """The `softras2d.Scene` of a soup."""
    import softras2d as sr

    colors = soup.colors[:, 0] if soup.flat else soup.colors
    return sr.Scene.from_soup(soup.corners, colors[..., :3] if soup.opaque else colors)


def loop(soup: Soup, samples: int, threads: int, *, by_rows: bool) -> Contestant:
    """The plain compiled loop over samples, or (`by_rows`) the scanline renderer."""
    rate = round(samples**0.5)
    render = scanline.render if by_rows else scalar_loop.render
    return Contestant(
        "scanline" if by_rows else "scalar loop",
        _label(samples),
        threads,
        lambda: render(soup, rate, threads),
        np.asarray,
    )


def _label(samples: int) -> str:
    return "1 sample" if samples == 1 else f"{samples} samples"
