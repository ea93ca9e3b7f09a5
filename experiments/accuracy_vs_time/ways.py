"""Every way to draw a scene: softras2d's coverage modes, the compiled loop, and other libraries."""

# pyright: reportMissingImports=false

import importlib.util
from collections.abc import Iterator
from typing import Any

import numpy as np

import softras2d as sr

from ..common import scanline
from ..common.references import IDEAL
from ..hard_speed import peers
from ..hard_speed.contestant import Contestant
from ..hard_speed.ours import CORES
from ..hard_speed.peers import canvas
from . import textured_peers
from .subjects import MIPMAPPED, Subject

OURS = ("Hard", "Hard, pixel shading", "Soft", "Area")
"""Families of softras2d; all others are peers."""
SAMPLES = (1, 4, 9, 16, 64, 256)
WIDTHS_PX = (0.5, 0.8, 1.2, 2.0)
_SHORT = {
    canvas.ANTI_ALIASED: "AA",
    canvas.ONE_SAMPLE: "1",
    canvas.LARGE: "4x4",
    canvas.LARGE_ANTI_ALIASED: "4x4 AA",
}
_NEEDS = {
    "DEODR": "deodr",
    "Skia": "skia",
    "Blend2D": "blend2d",
    "Cairo": "cairo",
    "OpenCV": "cv2",
}


def missing() -> list[str]:
    """Names of the peers that are left out because they are not installed."""
    return [name for name, module in _NEEDS.items() if importlib.util.find_spec(module) is None]


def contestants(subject: Subject, quick: bool) -> list[Contestant]:
    """All renderers of this scene; their `sampling` is the label of the point in the figure."""
    ours = [_package(subject, *one) for one in _choices(subject, quick)]
    if subject.textured:
        return ours + textured_peers.contestants(subject)
    return ours + _loops(subject, quick) + _libraries(subject) + _deodr(subject)


def coverages(subject: Subject, quick: bool) -> Iterator[tuple[str, str, Any]]:
    """Yield family, label and coverage of each mode that draws all kinds of scenes."""
    for samples in (16,) if quick else SAMPLES:
        yield "Hard", str(samples), sr.Hard(samples)
    for width in _few(subject) if quick else WIDTHS_PX:
        yield "Soft", f"{width:g} px", sr.Soft(width)
    yield "Area", "over", sr.Area("over")
    if subject.tiling:
        yield "Area", "sum", sr.Area("sum")


def _few(subject: Subject) -> tuple[float, ...]:
    """Widths of `Soft` in a quick run, in pixels; none for a tiling, which has a second `Area`."""
    return () if subject.tiling else (0.8,)


def _choices(subject: Subject, quick: bool) -> Iterator[tuple[str, str, Any, sr.Filter]]:
    """Yield family, label, coverage and filter of each mode.

    In labels, `mip` is the trilinear filter; `mip -1` lowers its mip levels by one.
    """
    if not subject.textured:
        for choice in coverages(subject, quick):
            yield *choice, IDEAL
        return
    for family, label, coverage in coverages(subject, quick):
        if family == "Hard":
            yield family, label, coverage, IDEAL
        elif not quick:
            yield family, f"{label} mip", coverage, MIPMAPPED
    for samples in (1,) if quick else (1, 4, 16):
        yield "Hard", f"{samples} mip", sr.Hard(samples), MIPMAPPED
    for samples in () if quick else (4, 16, 64):
        bias = -float(np.log2(samples)) / 2
        finer = sr.Filter(pixel="bilinear", level="linear", lod_bias=bias)
        yield "Hard", f"{samples} mip {bias:+g}", sr.Hard(samples), finer
    for samples in (16,) if quick else (4, 16, 64):
        coverage = sr.Hard(samples, shading="pixel")
        yield "Hard, pixel shading", f"{samples} mip", coverage, MIPMAPPED


def _package(
    subject: Subject, family: str, label: str, coverage: Any, how: sr.Filter
) -> Contestant:
    scene, size = subject.scene, subject.size
    plan = sr.plan(scene, height=size, width=size, coverage=coverage, filter=how)
    return Contestant(
        family, label, CORES, lambda: sr.render(scene, plan).block_until_ready(), np.asarray
    )


def _loops(subject: Subject, quick: bool) -> list[Contestant]:
    """The compiled scanline renderer of the experiments, on as many cores as softras2d has."""
    assert subject.soup is not None
    soup = subject.soup

    def one(rate: int) -> Contestant:
        label = str(rate * rate)
        return Contestant(
            "compiled scanline",
            label,
            CORES,
            lambda: scanline.render(soup, rate, CORES),
            np.asarray,
        )

    return [one(rate) for rate in ((4,) if quick else (2, 4, 8, 16))]


def _libraries(subject: Subject) -> list[Contestant]:
    assert subject.soup is not None
    return [
        Contestant(one.family, _SHORT[one.sampling], one.threads, one.draw, one.image)
        for one in peers.contestants(subject.soup)
        if one.sampling in _SHORT
    ]


def _deodr(subject: Subject) -> list[Contestant]:
    soup = subject.soup
    if soup is None or not soup.opaque or "DEODR" in missing():
        return []
    from ..gradient_accuracy.with_deodr import Deodr

    def one(rate: int) -> Contestant:
        peer, size = Deodr(soup, rate), subject.size

        def draw() -> np.ndarray:
            large = peer.scene.render(1.0)[0]
            return large.reshape(size, rate, size, rate, 3).mean((1, 3)) if rate > 1 else large

        return Contestant("DEODR", "1x1" if rate == 1 else "4x4", 1, draw, np.asarray)

    return [one(1), one(4)]
