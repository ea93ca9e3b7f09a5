"""Answers Ctrl-C and SIGTERM at once, while a compiled program keeps the main thread busy."""

import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from rich.console import Console

_ANSWERS = (
    "stopping, writing the best so far; once more to give up",
    "giving up; a checkpoint (-o FIT.npz) is kept",
)
"""Lines that are printed after the first and after the second signal."""


@contextmanager
def announce_signals(console: Console) -> Iterator[None]:
    """In a `with` block, print a line at once for each of the first two signals, Ctrl-C or SIGTERM.

    SIGTERM has the effect of Ctrl-C. A line is printed only while the body of the block has
    replaced Python's handler of Ctrl-C. Python runs signal handlers in the main thread, between two
    instructions, so a handler waits for the end of a compiled program. Another thread, which learns
    of the signal by `signal.set_wakeup_fd`, prints the lines. If this function is not called in the
    main thread, it does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    sender, receiver = socket.socketpair()
    sender.setblocking(False)
    thread = threading.Thread(target=_answer, args=(receiver, console), daemon=True)
    thread.start()
    previous_wakeup = signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)
    previous_handler = signal.signal(signal.SIGTERM, _act_like_ctrl_c)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous_handler)
        signal.set_wakeup_fd(previous_wakeup)
        sender.close()
        thread.join()
        receiver.close()


def _act_like_ctrl_c(number: int, frame: FrameType | None) -> None:
    """Handle SIGTERM by calling the current handler of Ctrl-C, if that is a Python function."""
    handler = signal.getsignal(signal.SIGINT)
    if callable(handler):
        handler(number, frame)


def _answer(receiver: socket.socket, console: Console) -> None:
    """Print a line for each of the first two signals, until the other end of the socket is closed.

    A signal counts if it is Ctrl-C or SIGTERM, and arrives while Python's handler of Ctrl-C is
    replaced. `receiver`: the socket that receives the number of each signal as one byte.
    """
    answers = iter(_ANSWERS)
    while data := receiver.recv(1):
        # With Python's default handler, nothing is deferred: the command ends at once.
        is_deferred = signal.getsignal(signal.SIGINT) is not signal.default_int_handler
        if data[0] in (signal.SIGINT, signal.SIGTERM) and is_deferred:
            answer = next(answers, None)
            if answer is not None:
                console.print(answer, style="yellow")
