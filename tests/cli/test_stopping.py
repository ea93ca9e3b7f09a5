"""Ctrl-C and other signals take effect at once, even while the main thread runs no Python code."""

import io
import os
import signal
import sys
import threading
import time

import pytest
from rich.console import Console

from softras2d.cli.stopping import announce_signals
from softras2d.fitting.interrupt import deferred_interrupt

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs SIGINT")


def wait_for_lines(text: io.StringIO, count: int) -> list[str]:
    limit = time.monotonic() + 10
    while ((lines := text.getvalue().splitlines()) and len(lines) < count) or not lines:
        assert time.monotonic() < limit
        time.sleep(0.01)
    return lines


def test_each_signal_has_its_line_and_sigterm_acts_like_ctrl_c():
    text = io.StringIO()
    before = signal.getsignal(signal.SIGTERM)
    with announce_signals(Console(file=text, width=200)), deferred_interrupt() as interrupt:
        os.kill(os.getpid(), signal.SIGTERM)
        assert "once more to give up" in wait_for_lines(text, 1)[0]
        assert interrupt.requested
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(1)
        assert "giving up" in wait_for_lines(text, 2)[1]
    assert signal.getsignal(signal.SIGTERM) is before
    assert signal.set_wakeup_fd(-1) == -1


def test_a_signal_that_is_not_deferred_has_no_line():
    text = io.StringIO()
    with pytest.raises(KeyboardInterrupt), announce_signals(Console(file=text)):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1)
    assert text.getvalue() == ""


def test_other_threads_answer_nothing():
    entered = []

    def work():
        with announce_signals(Console(file=io.StringIO())):
            entered.append(signal.getsignal(signal.SIGTERM))

    before = signal.getsignal(signal.SIGTERM)
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert entered == [before]
