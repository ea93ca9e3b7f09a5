"""Answers requests one after another in a thread, and drops those that newer ones replace."""

import itertools
import logging
import threading
from collections.abc import Callable, Hashable, Iterator
from typing import NamedTuple

from .session import Reply

_LOGGER = logging.getLogger(__name__)


class _Job(NamedTuple):
    """A request whose replies are still to be computed.

    - `rank`: 0 for the most urgent requests; requests of greater rank wait.
    - `sequence_number`: of requests of equal rank, the one with the least is answered first.
    - `replies`: iterator that computes the next reply when it is advanced.
    - `deliver`: called with each reply.
    """

    rank: int
    sequence_number: int
    replies: Iterator[Reply]
    deliver: Callable[[Reply], None]


class Worker:
    """Computes replies to requests in a separate thread, the most urgent first.

    A job is a request whose replies are being computed. A job with several replies waits after each
    reply while there are more urgent jobs, of smaller rank.
    """

    def __init__(self):
        self._jobs: dict[tuple[Hashable, Hashable], _Job] = {}
        self._numbers = itertools.count()
        self._changed = threading.Condition()
        self._is_closed = False
        self._thread = threading.Thread(target=self._run, name="softras2d viewer", daemon=True)
        self._thread.start()

    def submit(
        self,
        owner: Hashable,
        name: Hashable,
        rank: int,
        replies: Iterator[Reply],
        deliver: Callable[[Reply], None],
    ) -> None:
        """Compute `replies`, and call `deliver` with each, in the thread of the worker.

        - `owner`: the page or output that sent the request; `forget` drops all of its jobs.
        - `name`: kind and slot of the request. An earlier job of the same owner and name is
          dropped; if its next reply is being computed, that reply is still delivered.
        - `rank`: 0 for the most urgent jobs; jobs of greater rank wait.
        """
        with self._changed:
            self._jobs[owner, name] = _Job(rank, next(self._numbers), replies, deliver)
            self._changed.notify()

    def forget(self, owner: Hashable) -> None:
        """Drop all jobs of an owner.

        A reply that is being computed is still delivered; no further reply of its job is.
        """
        with self._changed:
            for key in [key for key in self._jobs if key[0] == owner]:
                del self._jobs[key]

    def close(self, seconds: int | float = 0) -> None:
        """Drop all requests, and wait up to `seconds` for the reply that is being computed.

        The thread of the worker ends after this reply. Later requests are not answered.
        """
        with self._changed:
            self._jobs.clear()
            self._is_closed = True
            self._changed.notify()
        self._thread.join(seconds)

    def _run(self) -> None:
        """Compute replies until the worker is closed."""
        while True:
            with self._changed:
                while not self._jobs and not self._is_closed:
                    self._changed.wait()
                if self._is_closed:
                    return
                key, job = min(self._jobs.items(), key=lambda item: item[1][:2])
            reply = next(job.replies, None)
            with self._changed:
                # Another job may have taken the place of this one meanwhile.
                if reply is None and self._jobs.get(key) is job:
                    del self._jobs[key]
            if reply is not None:
                self._deliver(job, reply)

    def _deliver(self, job: _Job, reply: Reply) -> None:
        """Deliver a reply; an error is logged."""
        try:
            job.deliver(reply)
        except Exception as error:
            # A page that cannot be reached must not end the thread, which serves others too.
            _LOGGER.error("a reply was not delivered: %s", " ".join(str(error).split())[:300])
