"""Plots how fits converge."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal

from .library import COLORS, Axes, import_pyplot

if TYPE_CHECKING:
    from ..fitting.result import FitResult
else:
    # The type alone would import JAX.
    FitResult = Any

_AXES = {"seconds": ("seconds", "time (seconds)"), "step": ("steps", "steps")}
_LINES = ("-", "--", ":", "-.")


def convergence(
    results: Mapping[str, FitResult],
    *,
    against: Literal["seconds", "step"] = "seconds",
    axes: Axes | None = None,
) -> Axes:
    """Plot the PSNR of fits, in dB, against time or steps.

    - `results`: results of `fit`, by the names that the legend shows.
    - `against`: `"seconds"` or `"step"`, counted from the start of each fit, or of the fit that it
      resumed.
    - `axes`: matplotlib axes to draw into; by default the axes of a new figure.

    The PSNR is read from the `history` of each result: it compares the fitted image with the
    target, at the size and with the coverage that the fit used. Returns the axes. Raises
    `ValueError` for no results, a result without history, and another `against`.
    """
    if against not in _AXES:
        raise ValueError(f'`against` must be "seconds" or "step"; got {against!r}.')
    if not results:
        raise ValueError("`results` must hold at least one result; got none.")
    for name, result in results.items():
        if not result.history:
            raise ValueError(f"`results`: {name!r} has no history.")
    if axes is None:
        _, axes = import_pyplot().subplots(figsize=(6.4, 4), layout="constrained")
        assert axes is not None
    field, label = _AXES[against]
    for index, (name, result) in enumerate(results.items()):
        axes.plot(
            [getattr(record, field) for record in result.history],
            [record.psnr for record in result.history],
            label=name,
            color=COLORS[index % len(COLORS)],
            linestyle=_LINES[index // len(COLORS) % len(_LINES)],
            marker="o",
            markersize=3,
        )
    axes.set(xlabel=label, ylabel="PSNR of the fitted image (dB)")
    axes.grid(alpha=0.3)
    axes.legend()
    return axes
