"""The table of coverage modes: the only place that asks which kind of coverage an option is."""

from typing import Any

from ..options import Area, Coverage, Hard, Soft
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
    """The mode of an option; `ValueError` for anything else."""
    for option, mode in MODES.items():
        if isinstance(coverage, option):
            return mode
    names = [f"{option.__name__}(...)" for option in MODES]
    told = f"{', '.join(names[:-1])} or {names[-1]}"
    raise ValueError(f"`coverage` must be {told}; got {coverage!r}.")
