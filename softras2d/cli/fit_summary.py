"""Makes the line that `softras2d fit` prints about its result.

This module imports JAX, so it is imported only while a command runs.
"""

from collections.abc import Sequence
from pathlib import Path

from ..fitting.budget import MAX_START_SHARE
from ..fitting.layers.schedule import GROWTH_END
from ..fitting.mesh.saved import max_vertices
from ..fitting.result import FitResult
from .fit_files import browser_note, size_note
from .fit_paths import COMPACT, find_suffix


def summary(
    outputs: Sequence[Path],
    result: FitResult,
    *,
    elapsed: int | float,
    shares: Sequence[float],
    seconds: int | float | None,
) -> str:
    """Make the line about a fit: its files, the number of triangles, the scores and the time.

    - `outputs`: the files that were written. If there is an SVG file among them, the text of
      `browser_note` is appended; if there is a compact file, that of `size_note` about the first.
    - `elapsed`: seconds since the command began.
    - `shares`, `seconds`: as in `shortfall`, whose reason is included if triangles are missing.
    """
    count, wanted = len(result.scene.triangles), result.settings["triangles"]
    reason = shortfall(result, shares, seconds)
    triangles = f"{count} triangles" if reason is None else f"{count} of {wanted} triangles"
    because = "" if reason is None else f" ({reason})"
    note = browser_note(result) if find_suffix(outputs, ".svg") else ""
    compact = find_suffix(outputs, COMPACT)
    note += "" if compact is None else size_note(compact, result)
    return (
        f"{', '.join(map(str, outputs))}: {triangles}{because}, PSNR {result.psnr:.2f} dB, SSIM "
        f"{result.ssim:.3f}, {elapsed:.1f} s{note}"
    )


def shortfall(
    result: FitResult, shares: Sequence[float], seconds: int | float | None
) -> str | None:
    """Say why a fit has fewer triangles than asked for, and what may help; None if it has all.

    - `shares`: share of the fit that was done at each progress report, in 0..1. There is a report
      after each chunk, which is a number of steps during which no triangles are added.
    - `seconds`: the time limit of the fit in seconds; None if it was limited by steps.
    """
    count, settings = len(result.scene.triangles), result.settings
    wanted = settings["triangles"]
    if count >= wanted:
        return None
    more = "--seconds" if seconds is not None else "--steps"
    if settings["start"] != "error":
        return "as many as the start has; --start error adds more"
    if settings["family"] == "mesh":
        if len(result.scene.positions) == max_vertices(settings):
            likely = wanted + (wanted - count)
            return f"vertices on the border have fewer; -n {likely} gives about {wanted}"
        started = result.history[0].seconds if result.history else 0.0
        if seconds is not None and started > MAX_START_SHARE * seconds:
            return "time was up for adding vertices; more --seconds, or a smaller --size, adds them"
    elif result.interrupted:
        return "stopped before the others were added"
    elif len(shares) < 2 or shares[-2] < GROWTH_END:
        # Triangles are added before a chunk, by the share of the fit at that time.
        cure = f"more {more}" if seconds is None else "more --seconds, or a smaller -n,"
        return f"the fit ended before the others were added; {cure} helps"
    return "more did not lower the error; a larger --size may use them"
