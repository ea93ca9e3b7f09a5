"""The table of coverage modes: no other file asks for the type of a coverage option."""

from typing import Any

from ..options import Area, Coverage, Hard, Soft
from .analytic import AnalyticMode
from .area import AreaMode
from .coverage_mode import CoverageMode
from .sampled import SampledMode
from .soft import SoftMode

MODES: dict[type[Coverage], CoverageMode] = {
    Hard: SampledMode(),
    Soft: SoftMode(),
    Area: AreaMode(),
}


def mode_of(coverage: Any) -> CoverageMode:
    """Return the mode that draws a coverage option; raise `ValueError` for any other value."""
    for option, mode in MODES.items():
        if isinstance(coverage, option):
            return mode
    names = [f"{option.__name__}(...)" for option in MODES]
    choices = f"{', '.join(names[:-1])} or {names[-1]}"
    raise ValueError(f"`coverage` must be {choices}; got {coverage!r}.")


def pixel_layers_mode_of(coverage: Coverage) -> AnalyticMode:
    """Return the mode of `Soft` or `Area`, for which `pixel_layers` works.

    Raises `ValueError` for any other value, such as `Hard`.
    """
    mode = mode_of(coverage)
    if not isinstance(mode, AnalyticMode):
        raise ValueError(
            f"`pixel_layers` needs a plan for Soft(...) or Area(...); got {coverage!r}: use "
            "`rasterize` for Hard(...)."
        )
    return mode
