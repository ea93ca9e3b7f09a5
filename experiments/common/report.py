"""Write results to disk: CSV, JSON, and a Markdown table between two markers of a README."""

import csv
import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

Row = Mapping[str, Any]


def write_csv(path: Path, rows: Sequence[Row]) -> None:
    """Write rows to CSV; columns are the keys of the first row, floats have four digits."""

    def write(temporary: Path) -> None:
        with temporary.open("w", newline="") as file:
            writer = csv.DictWriter(file, fieldnames=list(rows[0]))
            writer.writeheader()
            writer.writerows({key: _short(value) for key, value in row.items()} for row in rows)

    _replace(path, write)


def read_csv(path: Path) -> list[dict[str, Any]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def write_json(path: Path, value: Any) -> None:
    _replace(path, lambda temporary: temporary.write_text(json.dumps(value, indent=2) + "\n"))


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table; the first column is text, the others are aligned to the right."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" + "---:|" * (len(header) - 1)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def fill_markers(path: Path, name: str, text: str) -> None:
    """Replace the text between `<!-- name -->` and `<!-- /name -->` in a file."""
    begin, end = f"<!-- {name} -->", f"<!-- /{name} -->"
    page = path.read_text()
    if page.count(begin) != 1 or page.count(end) != 1:
        raise ValueError(f"{path.name} must contain {begin} and {end}, each once.")
    before, rest = page.split(begin)
    after = rest.split(end)[1]
    filled = f"{before}{begin}\n\n{text}\n\n{end}{after}"
    _replace(path, lambda temporary: temporary.write_text(filled))


def fill_or_print(path: Path | None, texts: Mapping[str, str]) -> None:
    """Write each text between the markers of its name in a file, or print it if `path` is None."""
    for name, text in texts.items():
        if path is None:
            print(f"\n{text}")
        else:
            fill_markers(path, name, text)


def save_figure(figure: Any, path: Path) -> None:
    """Write a matplotlib figure; the format follows the suffix."""
    _replace(path, lambda temporary: figure.savefig(temporary, dpi=150))


def _replace(path: Path, write: Callable[[Path], Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.stem}.tmp{path.suffix}")
    write(temporary)
    os.replace(temporary, path)


def _short(value: Any) -> Any:
    return f"{value:.4g}" if isinstance(value, float) else value
