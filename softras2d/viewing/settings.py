"""The settings of a view: how coverage is computed, and how textures are filtered."""

from dataclasses import dataclass, replace

from ..names import CoverageKind, FillRule, LevelFilter, PixelFilter, Shading, check_name
from ..options import Area, Coverage, Filter, Hard, Soft
from .message_fields import check_range

SOFT_WIDTHS = (0.1, 8.0)
"""Least and greatest width of soft edges, in pixels."""

LOD_BIASES = (-4.0, 4.0)
"""Least and greatest bias of the level of detail, in mip levels."""


@dataclass(frozen=True)
class Settings:
    """How a view is drawn.

    - `coverage`: `"sampled"` is `Hard`, to which `samples`, `fill_rule` and `shading` apply;
      `"soft"` is `Soft` with `soft_width`, in pixels; `"area"` is `Area`.
    - `pixel_filter`, `level_filter`, `anisotropy`, `lod_bias`: as in `Filter`.

    Raises `ValueError` for values that the options do not accept, and beyond `SOFT_WIDTHS` and
    `LOD_BIASES`, whatever `coverage` is.
    """

    coverage: CoverageKind = "sampled"
    samples: int = 16
    fill_rule: FillRule = "inclusive"
    shading: Shading = "sample"
    soft_width: float = 1.0
    pixel_filter: PixelFilter = "bilinear"
    level_filter: LevelFilter = "linear"
    anisotropy: int = 1
    lod_bias: float = 0.0

    def __post_init__(self):
        check_name("coverage", self.coverage, CoverageKind)
        check_range("soft_width", self.soft_width, *SOFT_WIDTHS)
        check_range("lod_bias", self.lod_bias, *LOD_BIASES)
        self.hard()
        self.filter_option()

    def hard(self) -> Hard:
        """The `Hard` option of these settings, even if `coverage` is not `"sampled"`."""
        return Hard(samples=self.samples, fill_rule=self.fill_rule, shading=self.shading)

    def coverage_option(self) -> Coverage:
        """The coverage as an option of `plan`."""
        if self.coverage == "soft":
            return Soft(width=self.soft_width)
        return Area() if self.coverage == "area" else self.hard()

    def filter_option(self) -> Filter:
        """The texture filter as an option of `plan`."""
        return Filter(
            pixel=self.pixel_filter,
            level=self.level_filter,
            anisotropy=self.anisotropy,
            lod_bias=self.lod_bias,
        )

    def planned_width(self) -> float | None:
        """The `max_width` of a plan: the width of soft edges rounded up to 1, 2, 4 or 8 pixels.

        A slider that changes the width therefore needs few plans. None if coverage is not soft.
        """
        if self.coverage != "soft":
            return None
        return next(width for width in (1.0, 2.0, 4.0, 8.0) if self.soft_width <= width)

    def without_arrays(self) -> "Settings":
        """These settings, with fixed values for the numbers that change without recompiling.

        The width of soft edges becomes `planned_width`, or 0.1 if coverage is not soft, and the
        bias of the level of detail becomes 0.
        """
        return replace(self, soft_width=self.planned_width() or SOFT_WIDTHS[0], lod_bias=0.0)
