"""Read measured points back, and find Pareto fronts and the fastest way below an error."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from .ways import OWN


@dataclass(frozen=True)
class Point:
    """One way on one scene: milliseconds, and one of its errors."""

    scene: str
    family: str
    label: str
    threads: int
    ms: float
    error: float

    @property
    def own(self) -> bool:
        return self.family in OWN

    @property
    def name(self) -> str:
        return f"{self.family}, {self.label}"


def read(rows: Sequence[dict[str, Any]], error: str) -> list[Point]:
    """`error` names the column."""
    return [
        Point(
            row["scene"],
            row["family"],
            row["label"],
            int(row["threads"]),
            float(row["median_ms"]),
            float(row[error]),
        )
        for row in rows
    ]


def front(points: Sequence[Point]) -> list[Point]:
    """Those that no other beats in time and error at once, the quickest first."""
    found: list[Point] = []
    for point in sorted(points, key=lambda one: (one.ms, one.error)):
        if not found or point.error < found[-1].error:
            found.append(point)
    return found


def quickest(points: Sequence[Point], most: float) -> Point | None:
    """The least time with an error of `most` at most."""
    good = [point for point in points if point.error <= most]
    return min(good, key=lambda one: one.ms, default=None)


ALIKE = 1.01
"""Errors that differ by a hundredth are alike: eight bits and float32 round differently."""


def ahead(points: Sequence[Point]) -> Iterator[tuple[Point, Point | None]]:
    """Peers that no way of ours matches in time and error at once, the quickest first.

    Beside each, our quickest way with an error as low (`ALIKE`); None if there is none.
    """
    own = [point for point in points if point.own]
    for peer in sorted((point for point in points if not point.own), key=lambda one: one.ms):
        match = quickest(own, ALIKE * peer.error)
        if match is None or match.ms > peer.ms:
            yield peer, match
