"""Read measured points back, and find Pareto fronts and the fastest way below an error."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from .ways import OURS


@dataclass(frozen=True)
class Point:
    """One method on one scene, with its time and one of its errors."""

    scene: str
    family: str
    label: str
    threads: int
    ms: float
    error: float

    @property
    def is_ours(self) -> bool:
        """Whether the method is one of softras2d."""
        return self.family in OURS

    @property
    def name(self) -> str:
        return f"{self.family}, {self.label}"


def read(rows: Sequence[dict[str, Any]], error: str) -> list[Point]:
    """Convert rows to points; `error` names the column of the error."""
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
    """The Pareto front: no other point has both less time and less error. Fastest first."""
    best: list[Point] = []
    for point in sorted(points, key=lambda one: (one.ms, one.error)):
        if not best or point.error < best[-1].error:
            best.append(point)
    return best


def quickest(points: Sequence[Point], most: float) -> Point | None:
    """The fastest point whose error is at most `most`; None if there is none."""
    good = [point for point in points if point.error <= most]
    return min(good, key=lambda one: one.ms, default=None)


ALIKE = 1.01
"""Errors that differ by 1 % count as equal, because eight bits and float32 round differently."""


def ahead(points: Sequence[Point]) -> Iterator[tuple[Point, Point | None]]:
    """Peers that are faster than all methods of softras2d with as low an error; fastest first.

    Each peer comes with the fastest method of softras2d whose error is as low (within `ALIKE`), or
    with None if no method is as accurate.
    """
    ours = [point for point in points if point.is_ours]
    for peer in sorted((point for point in points if not point.is_ours), key=lambda one: one.ms):
        match = quickest(ours, ALIKE * peer.error)
        if match is None or match.ms > peer.ms:
            yield peer, match
