"""Read measured times back and look them up."""

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Entry:
    """Times of one contestant on one scene, as `run.py` writes them.

    `rmse` is None for contestants that only time calls and draw no image.
    """

    kind: str
    triangles: int
    size_px: int
    family: str
    sampling: str
    threads: int
    median_ms: float
    least_ms: float
    rmse: float | None

    @property
    def label(self) -> str:
        """Family and sampling, and the number of threads if there are several."""
        cores = f", {self.threads} threads" if self.threads > 1 else ""
        return f"{self.family}, {self.sampling}{cores}"


@dataclass(frozen=True)
class Times:
    """All entries of a run, in the order in which they were measured."""

    entries: tuple[Entry, ...]

    def scene(self, kind: str, triangles: int, size_px: int) -> list[Entry]:
        wanted = (kind, triangles, size_px)
        return [e for e in self.entries if (e.kind, e.triangles, e.size_px) == wanted]

    def find(
        self,
        family: str,
        sampling: str,
        *,
        kind: str = "flat",
        triangles: int = 1000,
        size_px: int = 512,
        parallel: bool | None = None,
    ) -> Entry | None:
        """The entry, or None if the run lacks it; `parallel` selects among the compiled loops."""
        for entry in self.scene(kind, triangles, size_px):
            if (entry.family, entry.sampling) == (family, sampling) and (
                parallel is None or parallel == (entry.threads > 1)
            ):
                return entry
        return None

    def labels(self, kind: str, samplings: tuple[str, ...]) -> Iterator[str]:
        """Each contestant of a kind of scene once, in order."""
        labels_of_entries = (
            e.label for e in self.entries if e.kind == kind and e.sampling in samplings
        )
        yield from dict.fromkeys(labels_of_entries)


def load(path: Path) -> Times:
    with path.open(newline="") as file:
        return Times(tuple(_entry(row) for row in csv.DictReader(file)))


def _entry(row: dict[str, str]) -> Entry:
    return Entry(
        kind=row["kind"],
        triangles=int(row["triangles"]),
        size_px=int(row["size_px"]),
        family=row["family"],
        sampling=row["sampling"],
        threads=int(row["threads"]),
        median_ms=float(row["median_ms"]),
        least_ms=float(row["least_ms"]),
        rmse=float(row["rmse"]) if row["rmse"] else None,
    )
