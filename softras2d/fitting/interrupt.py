"""Defer Ctrl-C until the end of a chunk of steps, when nothing is half changed."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any


@dataclass
class Interrupt:
    """Flags that tell whether Ctrl-C has been pressed once, `requested`, and twice, `repeated`."""

    requested: bool = False
    repeated: bool = False

    def raise_if_repeated(self) -> None:
        """Raise `KeyboardInterrupt` if Ctrl-C has been pressed twice.

        The second Ctrl-C has raised the exception already, but a function may have caught it.
        """
        if self.repeated:
            raise KeyboardInterrupt


@contextmanager
def deferred_interrupt() -> Iterator[Interrupt]:
    """Record the first Ctrl-C in a `with` block, instead of raising `KeyboardInterrupt`.

    Yields an `Interrupt`, which the block must look at in order to end in time. A second Ctrl-C
    raises `KeyboardInterrupt`. At the end of the block, the earlier signal handler is restored. In
    threads other than the main thread nothing is recorded, because Python delivers Ctrl-C to the
    main thread alone.
    """
    interrupt = Interrupt()
    if threading.current_thread() is not threading.main_thread():
        yield interrupt
        return

    def handle(number: int, frame: Any) -> None:
        interrupt.repeated = interrupt.requested
        interrupt.requested = True
        interrupt.raise_if_repeated()

    previous = signal.signal(signal.SIGINT, handle)
    try:
        yield interrupt
    finally:
        signal.signal(signal.SIGINT, previous)
