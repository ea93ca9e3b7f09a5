"""Targets for the speed of hard mode, and whether the run meets them."""

from typing import Any, NamedTuple

from .times import Entry, Times


class Target(NamedTuple):
    """A row of the table; `met` is None if the row has no target."""

    question: str
    asked: str
    value: str
    least: str
    met: bool | None


def targets(times: Times, fresh: list[dict[str, Any]]) -> list[Target]:
    """Rows in a fixed order; a row whose entries are missing from the run is left out."""
    return [*_against_others(times), *_against_itself(times), *_fresh(fresh)]


def _against_others(times: Times) -> list[Target]:
    """Ratios of the time of softras2d at 16 samples to the times of peers with as many samples."""
    rows = []
    for count, most in ((1000, 0.6), (10_000, 1.0), (100_000, 1.0)):
        ours = times.find("softras2d", "16 samples", triangles=count)
        for peer in ("Skia", "Blend2D"):
            other = times.find(peer, "4x4 canvas", triangles=count)
            rows += _ratio(f"N = {count:,}: time / {peer} on a 4x4 canvas", ours, other, most)
    ours = times.find("softras2d", "16 samples")
    for family, asked in (("scalar loop", 0.25), ("scanline", None)):
        for parallel, on in ((False, "one thread"), (True, "all cores")):
            other = times.find(family, "16 samples", parallel=parallel)
            most = None if parallel else asked
            rows += _ratio(f"N = 1,000: time / {family}, {on}", ours, other, most)
    return rows


def _against_itself(times: Times) -> list[Target]:
    ours = times.find("softras2d", "16 samples")
    rows = _ratio("64 samples / 16, N = 1,000", times.find("softras2d", "64 samples"), ours, 3.0)
    rows += _ratio(
        "1024 px / 512 px, N = 100,000",
        times.find("softras2d", "16 samples", triangles=100_000, size_px=1024),
        times.find("softras2d", "16 samples", triangles=100_000),
        2.5,
    )
    for kind, name in (("flat_a50", "alpha 0.5"), ("gouraud", "corner colours")):
        of_kind = times.find("softras2d", "16 samples", kind=kind)
        rows += _ratio(f"{name} / flat opaque, N = 1,000", of_kind, ours, None)
    return rows


def _fresh(first_renders: list[dict[str, Any]]) -> list[Target]:
    rows = []
    for row in first_renders:
        scene = f"{row['kind']}, N = {row['triangles']:,}, {row['size_px']} px, 16 samples"
        if row["size_px"] == 512:
            seconds, alike = row["first_render_s"], row["alike_render_s"]
            rows += [
                Target(
                    f"first render: {scene}", "<= 2.5 s", f"{seconds:.2f} s", "", seconds <= 2.5
                ),
                Target(f"next, similar render: {scene}", "", f"{alike:.2f} s", "", None),
            ]
        else:
            gib = row["peak_mib"] / 1024
            rows.append(Target(f"peak memory: {scene}", "< 4 GB", f"{gib:.2f} GiB", "", gib < 3.72))
    return rows


def _ratio(
    question: str, entry: Entry | None, yardstick: Entry | None, most: float | None
) -> list[Target]:
    if entry is None or yardstick is None:
        return []
    value = entry.median_ms / yardstick.median_ms
    return [
        Target(
            question,
            "" if most is None else f"<= {most:g}",
            f"{value:.2f}",
            f"{entry.least_ms / yardstick.least_ms:.2f}",
            None if most is None else value <= most,
        )
    ]
