"""Refuses requests that do not come from a page of this server.

Any web page may send requests to 127.0.0.1. If the page lets a name resolve to that address, it may
also read the answers. So each request must name this server as its host, must not come from a page
of another origin, and must have the token, which only the printed address contains.

**Source:** OWASP, *Cross-Site WebSocket Hijacking*, for the origin; Jackson et al., *Protecting
Browsers from DNS Rebinding Attacks* (CCS 2007), for the host.
"""

import secrets

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocketClose

NAMES = ("127.0.0.1", "localhost")
"""Host names under which a browser may call the server."""


class Guard:
    """Web application that passes allowed requests on to the application `app`.

    A request is allowed if its host is this server at `port`; if its origin, should it have one, is
    a page of this server; and if its path begins with `token`, which is removed from the path.
    Other requests are answered with status 403.
    """

    def __init__(self, app: ASGIApp, token: str, port: int):
        self._app = app
        self._prefix = f"/{token}"
        self._hosts = {f"{name}:{port}" for name in NAMES}
        self._origins = {f"http://{host}" for host in self._hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request, by the interface of ASGI."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
        elif self._is_allowed(scope):
            path = scope["path"][len(self._prefix) :]
            await self._app({**scope, "path": path, "raw_path": path.encode()}, receive, send)
        elif scope["type"] == "websocket":
            # Before it is accepted, closing a WebSocket is answered with 403.
            await WebSocketClose()(scope, receive, send)
        else:
            await PlainTextResponse("refused\n", 403)(scope, receive, send)

    def _is_allowed(self, scope: Scope) -> bool:
        """Whether a request has the right host and token, and no origin or the right one."""
        headers = Headers(scope=scope)
        origin = headers.get("origin")
        start = scope["path"][: len(self._prefix) + 1]
        return (
            headers.get("host") in self._hosts
            and (origin is None or origin in self._origins)
            and secrets.compare_digest(start.encode(), f"{self._prefix}/".encode())
        )
