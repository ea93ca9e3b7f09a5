"""Runs the server of the viewer in a thread, on 127.0.0.1."""

import secrets
import socket
import threading
import time
from types import TracebackType

import uvicorn

from .guard import Guard
from .server import make_app
from .session import Session
from .worker import Worker

ADDRESS = "127.0.0.1"

MAX_MESSAGE_BYTES = 2**16
"""Maximum length of a message that a page may send, in bytes; requests are far shorter."""

_END_SECONDS = 20.0
"""Maximum time, in seconds, that `close` waits for the picture that is being drawn.

Python must not end while XLA compiles.
"""

_SEND_SECONDS = 0.2
"""Time, in seconds, for the last picture to be sent to the pages."""


class ViewerServer:
    """A running server of the viewer, which `close` ends. It is also a context manager.

    It answers the pages from `session`, which is closed with the server. Raises `OSError` if the
    port cannot be used, for example because it is in use.

    - `port`: the port of 127.0.0.1; if the argument is 0, a free port is chosen.
    - `url`: the address of the page, with a secret token.
    """

    def __init__(self, session: Session, port: int = 0):
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.bind((ADDRESS, port))
            # From now on pages may connect; they are served when the server has started.
            self._socket.listen()
        except OSError as error:
            self._socket.close()
            message = f"port {port} of {ADDRESS}: {error.strerror}"
            raise OSError(error.errno, message) from None
        self.port: int = self._socket.getsockname()[1]
        token = secrets.token_urlsafe(16)
        self.url = f"http://{ADDRESS}:{self.port}/{token}/"
        self._session = session
        self._worker = Worker()
        config = uvicorn.Config(
            Guard(make_app(session, self._worker), token, self.port),
            log_level="warning",
            access_log=False,
            lifespan="off",
            server_header=False,
            ws="websockets-sansio",
            ws_max_size=MAX_MESSAGE_BYTES,
            # Compressing a picture would take longer than drawing it.
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=1,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(
            target=self._server.run, args=([self._socket],), name="softras2d server", daemon=True
        )
        self._thread.start()

    def wait(self) -> None:
        """Wait until the server has ended; Ctrl-C raises `KeyboardInterrupt`."""
        while self._thread.is_alive():
            self._thread.join(0.5)

    def close(self) -> None:
        """End the server, its worker and its session, after the picture that is being drawn.

        Waits at most `_END_SECONDS` for the picture, and again after Ctrl-C.
        """
        try:
            try:
                self._worker.close(_END_SECONDS)
            except KeyboardInterrupt:
                # On a second Ctrl-C, wait once more; a third one ends the wait.
                self._worker.close(_END_SECONDS)
            time.sleep(_SEND_SECONDS)
        finally:
            self._server.should_exit = True
            self._thread.join(_END_SECONDS)
            self._socket.close()
            self._session.close()

    def __enter__(self) -> "ViewerServer":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
