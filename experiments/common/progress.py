"""Progress bar for long runs, with the time of each step in seconds."""

from collections.abc import Iterable, Iterator, Sequence
from typing import TypeVar

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

Step = TypeVar("Step")


def steps(items: Iterable[Step], title: str) -> Iterator[Step]:
    """Iterate over `items` with a bar that names the current one."""
    items = items if isinstance(items, Sequence) else list(items)
    columns = (
        TextColumn(title),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[now]}"),
    )
    with Progress(*columns, transient=True) as progress:
        task = progress.add_task("", total=len(items), now="")
        for item in items:
            progress.update(task, now=str(item))
            yield item
            progress.advance(task)
