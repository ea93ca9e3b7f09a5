"""Compare images of the drawings of resvg's test suite with the pictures of the suite.

SOFTRAS2D_DATA=FOLDER python -m experiments.svg_files.suite
"""

from collections import Counter
from pathlib import Path

from tests.io.svg.test_suite import STANDARD_IS_RIGHT, SUITE, judged

from ..common import report

HERE = Path(__file__).parent

KINDS = (
    "agrees, without a warning",
    "agrees, and a warning names an error in the file",
    "agrees, and a warning names what is not supported",
    "differs, and a warning names the cause",
    "differs, where the standard contradicts the picture",
    "differs without a warning",
)


def kind_of(name: str, agrees: bool, messages: list[str]) -> str:
    """The kind of a drawing, one of `KINDS`."""
    if agrees and not messages:
        return KINDS[0]
    if agrees:
        is_error = all(
            " ".join(message.split()[1:]).startswith("ignored as invalid") for message in messages
        )
        return KINDS[1] if is_error else KINDS[2]
    if name in STANDARD_IS_RIGHT:
        return KINDS[4]
    return KINDS[3] if messages else KINDS[5]


def main() -> None:
    rows: list[dict[str, str]] = []
    counts: Counter[str] = Counter(dict.fromkeys(KINDS, 0))
    for path in sorted(SUITE.rglob("*.svg")):
        name = path.relative_to(SUITE).with_suffix("").as_posix()
        agrees, messages = judged(path)
        kind = kind_of(name, agrees, messages)
        counts[kind] += 1
        if kind != KINDS[0]:
            texts = [message.replace(str(path), "").lstrip(": ") for message in messages]
            why = STANDARD_IS_RIGHT.get(name, " ".join(texts))
            rows.append({"drawing": name, "kind": kind, "why": why})
            print(rows[-1], flush=True)
    report.write_csv(HERE / "results" / "suite.csv", rows)
    lines = [[kind, str(count)] for kind, count in counts.items()]
    report.fill_markers(HERE / "README.md", "suite", report.table(["drawings", "count"], lines))


if __name__ == "__main__":
    main()
