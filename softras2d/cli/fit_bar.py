"""Shows the progress bar of `softras2d fit`."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn


class FitBar:
    """The progress bar of `softras2d fit`, with a text that says what the command is doing.

    - `followers`: objects whose method `add` is called with each progress report of the fit; none
      at first.
    - `shares`: share of the fit that was done at each progress report so far, in 0..1.
    """

    def __init__(self, progress: Progress, task: TaskID):
        self.followers: Sequence[Any] = ()
        self.shares: list[float] = []
        self._progress, self._task = progress, task

    def show(self, status: str) -> None:
        """Show the text `status` beside the bar, without moving the bar."""
        self._progress.update(self._task, status=status)

    def advance(self, share: float, status: str) -> None:
        """Move the bar to the share `share` of the work, 0..1, and show `status` beside it."""
        self._progress.update(self._task, completed=share, status=status)

    def report(self, report: Any) -> None:
        """Show a `ProgressReport` of the fit, and pass it on to all `followers`.

        Its share is appended to `shares`, and moves the bar. The PSNR that is shown is the report's
        `saved_psnr`. Until that is known, it is the PSNR of the last step, at the size of the fit.
        """
        self.shares.append(report.share)
        record = report.record
        # The image of a step has another size and softer edges than the result.
        psnr = f"{report.saved_psnr:.2f} dB"
        if report.saved_psnr != report.saved_psnr:
            psnr = f"{record.psnr:.2f} dB at the size of the fit"
        status = (
            f"PSNR {psnr}, {record.active} of {report.triangles} triangles, step {record.steps}"
        )
        # NaN means that the time left is not known yet.
        if report.seconds_left == report.seconds_left:
            status += f", {report.seconds_left:.0f} s left"
        self.advance(report.share, status)
        for follower in self.followers:
            follower.add(report)


@contextmanager
def fit_bar(console: Console) -> Iterator[FitBar]:
    """Show a progress bar during a `with` block, if the console is a terminal.

    Yields the `FitBar` that moves the bar; without a terminal it shows nothing.
    """
    columns = (
        TextColumn("fitting"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[status]}"),
    )
    # When stderr is not a terminal, rich would still print an empty line.
    is_shown = console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=not is_shown) as progress:
        yield FitBar(progress, progress.add_task("", total=1.0, status="starting"))
