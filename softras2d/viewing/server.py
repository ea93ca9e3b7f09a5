"""Serves the page of the viewer, its script, and the WebSocket that carries messages.

A message from a page is a request, which a `Session` answers with replies; `session.py` describes
both.
"""

import asyncio
import contextlib
import json
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from .frames import frames_of
from .session import RANKS, Reply, Session, scalar
from .worker import Worker

STATIC = Path(__file__).parent / "static"

_FILES = {
    "/": ("index.html", "text/html"),
    "/viewer.js": ("viewer.js", "text/javascript"),
    "/viewer.css": ("viewer.css", "text/css"),
}
"""For the path of each file that is served, the file's name in `STATIC` and its media type."""

_HEADERS = {
    # The page loads nothing from the net, and no other page may embed it.
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "connect-src 'self'; img-src 'self' data: blob:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}

_POLL_SECONDS = 0.25
"""Time, in seconds, between two checks whether a subject has changed."""


def make_app(session: Session, worker: Worker) -> Starlette:
    """Make the web application that serves the page and its WebSocket, without a `Guard`."""

    async def socket(websocket: WebSocket) -> None:
        await websocket.accept()
        await _Connection(websocket, session, worker).serve()

    routes = [Route(path, _file, methods=["GET"]) for path in _FILES]
    return Starlette(routes=[*routes, WebSocketRoute("/socket", socket)])


async def _file(request: Request) -> Response:
    """Answer a request for one of the files of the page."""
    name, kind = _FILES[request.url.path]
    return Response((STATIC / name).read_bytes(), media_type=kind, headers=_HEADERS)


class _Connection:
    """The WebSocket connection of one open page."""

    def __init__(self, websocket: WebSocket, session: Session, worker: Worker):
        self._websocket = websocket
        self._session = session
        self._worker = worker
        self._loop = asyncio.get_running_loop()
        self._replies: list[Reply] = []
        self._has_replies = asyncio.Event()

    async def serve(self) -> None:
        """Receive requests and send replies until the page is closed, or the server ends."""
        tasks = [asyncio.create_task(task) for task in (self._send(), self._watch())]
        try:
            await self._receive()
        finally:
            self._worker.forget(self)
            self._session.set_shown_subject(self, None)
            for task in tasks:
                task.cancel()
            for task in tasks:
                with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                    await task

    async def _receive(self) -> None:
        """Pass requests on to the worker, until the page is closed.

        A message that is not a JSON object closes the connection too.
        """
        while True:
            message = await self._websocket.receive()
            if message["type"] != "websocket.receive":
                return
            request = _request(message.get("text"))
            if request is None:
                await self._websocket.close(1003)
                return
            kind, slot = (str(scalar(request.get(name))) for name in ("kind", "slot"))
            if (kind, slot) == ("picture", "a"):
                self._session.set_shown_subject(self, scalar(request.get("subject")))
            replies = self._session.answer(request)
            self._worker.submit(
                self, (kind, slot), RANKS.get(kind, 0), replies, self._deliver_from_worker
            )

    def _deliver_from_worker(self, reply: Reply) -> None:
        """Have the thread of the server deliver a reply; called in the thread of the worker."""
        # The server may have ended while a picture was drawn.
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._deliver, reply)

    def _deliver(self, reply: Reply) -> None:
        """Queue a reply for sending. A new picture replaces a waiting picture of the same slot.

        The slot says for which of the two pictures of a page it is (see `session`).
        """
        if reply.header["kind"] == "picture":
            # A page that is slow to receive gets the newest picture only.
            self._replies = [waiting for waiting in self._replies if not _replaces(reply, waiting)]
        self._replies.append(reply)
        self._has_replies.set()

    async def _send(self) -> None:
        """Send the queued replies to the page, until the task is cancelled."""
        while True:
            await self._has_replies.wait()
            while self._replies:
                for frame in frames_of(self._replies.pop(0)):
                    await self._websocket.send_bytes(frame)
            self._has_replies.clear()

    async def _watch(self) -> None:
        """Send the page a message whenever the contents of a subject change."""
        before = self._session.versions()
        while True:
            await asyncio.sleep(_POLL_SECONDS)
            versions = self._session.versions()
            if versions != before:
                before = versions
                self._deliver(Reply({"kind": "changed", "versions": versions}))


def _replaces(new: Reply, old: Reply) -> bool:
    """Whether a reply has the kind and the slot of an older one."""
    return all(new.header.get(name) == old.header.get(name) for name in ("kind", "slot"))


def _request(text: str | None) -> dict[str, Any] | None:
    """Decode the request of a message; None if it is not a JSON object."""
    try:
        request = json.loads(text or "")
    except (ValueError, RecursionError):
        return None
    return request if isinstance(request, dict) else None
