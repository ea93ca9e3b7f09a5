"""The filters that are compared."""

from collections.abc import Iterator
from typing import NamedTuple

import softras2d as sr

SAMPLES = (1, 4, 16)
ANISOTROPY = (2, 4, 8, 16)
_AT_ALL_SAMPLES = (4, 16)


class Method(NamedTuple):
    """A filter and its number of samples per pixel."""

    pixel: str
    level: str
    anisotropy: int
    samples: int

    @property
    def name(self) -> str:
        """The name of the filter, without its samples."""
        if self.anisotropy > 1:
            return f"anisotropic, {self.anisotropy} probes"
        return f"{self.pixel}, level {self.level}"

    @property
    def texels(self) -> int:
        """Texels that the program reads for each sample that it shades."""
        per_level = 4 if self.pixel == "bilinear" else 1
        return per_level * (2 if self.level == "linear" else 1) * self.anisotropy

    def filter(self) -> sr.Filter:
        return sr.Filter(self.pixel, self.level, self.anisotropy)  # pyright: ignore[reportArgumentType]


YARDSTICK = Method("bilinear", "zero", 1, 1)
"""Method by whose time all times are divided."""


def methods(quick: bool = False) -> Iterator[Method]:
    """Every pixel filter, level rule and number of samples, and then anisotropic filters.

    At one sample per pixel, all numbers of probes are drawn; at more samples, only 4 and 16 probes.
    `quick` has four filters at one sample.
    """
    samples = (1,) if quick else SAMPLES
    for pixel in ("nearest", "bilinear"):
        for level in ("zero", "linear") if quick else ("zero", "nearest", "linear"):
            for count in samples:
                yield Method(pixel, level, 1, count)
    for probes in (16,) if quick else ANISOTROPY:
        for count in samples:
            if count == 1 or probes in _AT_ALL_SAMPLES:
                yield Method("bilinear", "linear", probes, count)
