"""The server refuses requests that are not from its page, and reads only the files it serves."""

import http.client
import json
import socket
import sys
from collections.abc import Iterator
from urllib.parse import urlsplit

import numpy as np
import pytest
from typer.testing import CliRunner
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from softras2d.cli import app
from softras2d.viewing.serve import MAX_MESSAGE_BYTES, ViewerServer
from softras2d.viewing.server import STATIC

from ..cases.viewing import HEIGHT, WIDTH, small_session


@pytest.fixture(scope="module")
def server() -> Iterator[ViewerServer]:
    with ViewerServer(small_session()) as server:
        yield server


def status_of(server: ViewerServer, path: str, method: str = "GET", **headers: str) -> int:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=20)
    try:
        connection.request(method, path, headers=headers)
        return connection.getresponse().status
    finally:
        connection.close()


def path_of(server: ViewerServer) -> str:
    return urlsplit(server.url).path


def open_socket(server: ViewerServer, **keywords) -> ClientConnection:
    url = server.url.replace("http:", "ws:") + "socket"
    return connect(url, max_size=None, compression=None, **keywords)


def ask(page: ClientConnection, kind: str, **fields) -> tuple[dict, bytes]:
    page.send(json.dumps({"kind": kind, "id": 1} | fields))
    frame = page.recv(60)
    assert isinstance(frame, bytes)
    length = int.from_bytes(frame[:4], "little")
    return json.loads(frame[4 : 4 + length]), frame[4 + length :]


def test_the_page_is_served(server):
    path = path_of(server)
    assert status_of(server, path) == 200
    for name in ("viewer.js", "viewer.css"):
        assert status_of(server, path + name) == 200
    assert status_of(server, path, Host=f"localhost:{server.port}") == 200
    assert status_of(server, path, Origin=f"http://127.0.0.1:{server.port}") == 200


@pytest.mark.parametrize(
    "path",
    ["/", "/viewer.js", "/socket", "/wrong/", "/wrong/viewer.js", "/{}", "//", "/%2e%2e/"],
)
def test_requests_without_the_token_are_refused(server, path):
    token = path_of(server).strip("/")
    assert status_of(server, path.format(token[:-1])) == 403


def test_the_token_alone_is_not_enough(server):
    path = path_of(server)
    assert status_of(server, path, Host="example.com") == 403
    assert status_of(server, path, Host=f"example.com:{server.port}") == 403
    assert status_of(server, path, Host="127.0.0.1") == 403
    assert status_of(server, path, Origin="http://example.com") == 403
    assert status_of(server, path, Origin="null") == 403
    assert status_of(server, path, Origin=f"https://127.0.0.1:{server.port}") == 403


@pytest.mark.parametrize(
    "path",
    ["index.html", "../serve.py", "..%2fserve.py", "%2e%2e/serve.py", "/etc/passwd", "viewer.js/"],
)
def test_no_other_path_is_served(server, path):
    assert status_of(server, path_of(server) + path) in (307, 404)


def test_only_reading_is_allowed(server):
    for method in ("POST", "PUT", "DELETE"):
        assert status_of(server, path_of(server), method) == 405


def test_nothing_listens_on_other_addresses(server):
    connections = []
    for family, *_, address in socket.getaddrinfo(socket.gethostname(), server.port):
        if family == socket.AF_INET and not str(address[0]).startswith("127."):
            with socket.socket(family) as attempt:
                connections.append(attempt.connect_ex(address))
    assert all(connections)
    with socket.socket() as attempt:
        # On Linux, every address of 127.0.0.0/8 belongs to this machine.
        attempt.settimeout(10)
        assert attempt.connect_ex(("127.0.0.2", server.port)) != 0
    with socket.socket() as attempt:
        assert attempt.connect_ex(("127.0.0.1", server.port)) == 0


@pytest.mark.parametrize(
    ("token", "headers", "host"),
    [
        ("wrong", {}, None),
        (None, {"Origin": "http://example.com"}, None),
        (None, {"Origin": "null"}, None),
        (None, {}, "example.com"),
    ],
)
def test_sockets_of_others_are_refused(server, token, headers, host):
    path = f"/{token}/" if token else path_of(server)
    name = f"{host}:{server.port}" if host else f"127.0.0.1:{server.port}"
    raw = socket.create_connection(("127.0.0.1", server.port))
    with pytest.raises(InvalidStatus) as refused:
        connect(f"ws://{name}{path}socket", sock=raw, additional_headers=headers)
    assert refused.value.response.status_code == 403


def test_a_socket_answers(server):
    with open_socket(server) as page:
        header, payload = ask(page, "subjects")
        assert [subject["name"] for subject in header["subjects"]] == ["scene", "image"]
        assert payload == b""
        view = {"zoom": 1, "x": 0, "y": 0, "height": HEIGHT, "width": WIDTH}
        header, payload = ask(page, "picture", subject=1, view=view)
        assert header["kind"] == "picture"
        assert np.frombuffer(payload, np.uint8).size == 4 * HEIGHT * WIDTH


@pytest.mark.parametrize("size", [MAX_MESSAGE_BYTES + 1, 100_000_000])
def test_a_long_message_ends_its_page_and_no_other(server, size):
    with open_socket(server) as other:
        with open_socket(server) as page, pytest.raises(ConnectionClosed) as closed:
            page.send("x" * size)
            page.recv(20)
        # A server that closes in the middle of a message may also reset the connection.
        assert closed.value.rcvd is None or closed.value.rcvd.code == 1009
        assert ask(other, "subjects")[0]["kind"] == "subjects"


@pytest.mark.parametrize("message", ["", "[]", "{", "[" * 60_000, "1", b"{}"])
def test_what_is_no_request_ends_its_page(server, message):
    with open_socket(server) as page, pytest.raises(ConnectionClosed) as closed:
        page.send(message)
        page.recv(20)
    assert closed.value.rcvd is not None and closed.value.rcvd.code == 1003


def test_requests_name_no_files(server):
    with open_socket(server) as page:
        for path in ("/etc/passwd", str(STATIC / "viewer.js")):
            header, payload = ask(page, "picture", subject=path)
            assert header["kind"] == "error" and payload == b""


def test_a_server_ends_while_pages_are_open():
    server = ViewerServer(small_session())
    with open_socket(server) as page:
        ask(page, "subjects")
        server.close()
        with pytest.raises(ConnectionClosed):
            page.recv(20)
    with socket.socket() as attempt:
        assert attempt.connect_ex(("127.0.0.1", server.port)) != 0


def test_the_page_loads_nothing_from_the_net():
    for path in STATIC.iterdir():
        text = path.read_text(encoding="utf-8")
        assert "https:" not in text and "@import" not in text, path
        for word in ("http:", "//unpkg", "//cdn"):
            matching_lines = [line for line in text.splitlines() if word in line]
            # This address names an XML vocabulary, and is never loaded.
            assert all("http://www.w3.org/2000/svg" in line for line in matching_lines), path


def test_a_port_in_use_is_an_error(server):
    with pytest.raises(OSError, match=f"port {server.port} of 127.0.0.1: Address already in use"):
        ViewerServer(small_session(), server.port)


@pytest.mark.parametrize("port", ["0", "80", "1023", "65536"])
def test_ports_that_a_user_cannot_open_are_refused(port, tmp_path):
    path = tmp_path / "scene.svg"
    path.write_text("<svg/>")
    result = CliRunner().invoke(app, ["view", "--no-browser", "--port", port, str(path)])
    assert result.exit_code == 2
    assert "Invalid value for '--port'" in result.output


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.slow
def test_ctrl_c_ends_the_command(tmp_path):
    import signal
    import subprocess

    from softras2d import scenes

    command = [sys.executable, "-m", "softras2d", "view", "--no-browser", str(scenes.path("rings"))]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("viewer: http://127.0.0.1:")
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=60)
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == 0
    assert errors.split() == ["closing", "closed"]
