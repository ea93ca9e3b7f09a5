"""The thread that answers requests takes urgent ones first, and drops superseded ones."""

import threading
from collections.abc import Iterator

import pytest

from softras2d.viewing.session import Reply
from softras2d.viewing.worker import Worker


@pytest.fixture
def worker() -> Iterator[Worker]:
    worker = Worker()
    yield worker
    worker.close(10)


def replies(*names: str) -> Iterator[Reply]:
    """Replies with these names."""
    for name in names:
        yield Reply({"kind": name})


class Gate:
    """A reply named "first", which is computed from `has_begun` until `open` is set."""

    def __init__(self):
        self.has_begun, self.open = threading.Event(), threading.Event()

    def replies(self) -> Iterator[Reply]:
        self.has_begun.set()
        assert self.open.wait(10)
        yield Reply({"kind": "first"})


def test_superseded_requests_are_dropped_and_urgent_ones_come_first(worker):
    answered, gate, done = [], Gate(), threading.Event()

    def note(reply: Reply) -> None:
        answered.append(reply.header["kind"])
        if reply.header["kind"] == "last":
            done.set()

    worker.submit("page", "first", 0, gate.replies(), note)
    assert gate.has_begun.wait(10)
    for number in range(5):
        worker.submit("page", "picture", 1, replies(f"picture {number}"), note)
    worker.submit("page", "costs", 5, replies("cost a", "cost b", "last"), note)
    worker.submit("other", "picture", 1, replies("picture of another page"), note)
    worker.submit("page", "lens", 2, replies("lens"), note)
    gate.open.set()
    assert done.wait(10)
    assert answered == [
        "first", "picture 4", "picture of another page", "lens", "cost a", "cost b", "last",
    ]  # fmt: skip


def test_a_job_of_several_steps_waits_for_urgent_ones(worker):
    answered, done = [], threading.Event()

    def note(reply: Reply) -> None:
        answered.append(reply.header["kind"])
        if reply.header["kind"] == "cost a":
            worker.submit("page", "picture", 1, replies("picture"), note)
        if reply.header["kind"] == "last":
            done.set()

    worker.submit("page", "costs", 5, replies("cost a", "last"), note)
    assert done.wait(10)
    assert answered == ["cost a", "picture", "last"]


def test_jobs_of_a_closed_page_are_forgotten(worker):
    answered, gate, done = [], Gate(), threading.Event()

    def note(reply: Reply) -> None:
        answered.append(reply.header["kind"])
        if reply.header["kind"] == "last":
            done.set()

    worker.submit("page", "first", 0, gate.replies(), note)
    assert gate.has_begun.wait(10)
    worker.submit("page", "picture", 1, replies("picture"), note)
    worker.submit("other", "picture", 9, replies("last"), note)
    worker.forget("page")
    gate.open.set()
    assert done.wait(10)
    assert answered == ["first", "last"]


def test_a_reply_that_cannot_be_delivered_ends_its_job_alone(worker, caplog):
    done = threading.Event()

    def fail(reply: Reply) -> None:
        raise RuntimeError("the page is gone")

    worker.submit("page", "picture", 0, replies("a"), fail)
    worker.submit("other", "picture", 1, replies("b"), lambda reply: done.set())
    assert done.wait(10)
    assert [record.getMessage() for record in caplog.records] == [
        "a reply was not delivered: the page is gone"
    ]
    assert not caplog.records[0].exc_info
