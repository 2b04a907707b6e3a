"""Only the viewer's own page gets in; who speaks no HTTP is not worth a word."""

import socket
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator

import pytest

from scenes import tiny_scene
from splatwire.codec import encode_scene
from splatwire.errors import BackendUnavailableError
from splatwire.view.guard import refusal, start_guarded
from splatwire.view.looks import first_look
from splatwire.view.model import Settings, Viewer
from splatwire.view.sources import FileSource

pytest.importorskip("viser", reason="the viewer's extra is not installed")
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from splatwire.view.server import ViewerServer


@pytest.fixture(scope="module")
def server() -> Iterator[ViewerServer]:
    source = FileSource(encode_scene(tiny_scene(num_anchors=100)))
    server = ViewerServer(Viewer(source), Settings(), first_look(source.positions, None), ("grow",), port=0)
    thread = threading.Thread(target=server.run)
    thread.start()
    yield server
    server.stop()
    thread.join(10)


@pytest.mark.parametrize("asked", ["localhost:8080", "LOCALHOST", "127.0.0.1:1", "[::1]:80", "192.168.1.7", "mybox:80"])
def test_a_viewer_knows_its_own_page(asked):
    assert refusal({"Host": asked}, "mybox") is None
    assert refusal({"Host": asked, "Origin": f"http://{asked}", "Upgrade": "websocket"}, "mybox") is None


@pytest.mark.parametrize("headers", [
    {}, {"Host": ""}, {"Host": "evil.example:8080"}, {"Host": "127.0.0.1.evil.example"}, {"Host": "[evil]"},
    {"Host": "evil.example:8080", "Origin": "http://evil.example:8080", "Upgrade": "websocket"},
    {"Host": "localhost:8080", "Origin": "http://evil.example", "Upgrade": "websocket"},
    {"Host": "localhost:8080", "Origin": "http://localhost:3000", "Upgrade": "websocket"},
    {"Host": "localhost:8080", "Origin": "http://localhost:8080.evil.example", "Upgrade": "websocket"},
    {"Host": "localhost:8080", "Origin": "null", "Upgrade": "websocket"},
    {"Host": "localhost:8080", "Origin": "", "Upgrade": "websocket"},
    {"Host": "localhost:8080", "Upgrade": "WebSocket"}, {"Host": "localhost:8080", "Origin": "http://evil.example"},
])  # fmt: skip
def test_other_pages_are_refused(headers):
    assert refusal(headers, "127.0.0.1")


def test_web_sockets_of_other_pages_are_refused(server):
    address, protocols = server.url.replace("http", "ws"), [f"viser-v{viser.__version__}"]
    for origin in ("http://evil.example", None, "null"):
        with pytest.raises(InvalidStatus) as refused:
            connect(address, origin=origin, subprotocols=protocols, proxy=None)
        assert refused.value.response.status_code == 403
    with connect(address, origin=server.url, subprotocols=protocols, proxy=None) as own:
        assert own.recv(timeout=20)  # controls and scene


def test_a_name_that_somebody_else_had_point_here_opens_nothing(server):
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(urllib.request.Request(server.url, headers={"Host": "evil.example"}), timeout=20)
    assert refused.value.code == 403
    assert b"--host" in refused.value.read()


def test_who_speaks_no_http_is_not_worth_a_word(server, caplog):
    port = int(server.url.rpartition(":")[2])
    for said in (b"", b"\x00\x01\x02\r\n\r\n", b"GET"):
        with socket.create_connection(("127.0.0.1", port)) as stranger:
            stranger.sendall(said)
            stranger.shutdown(socket.SHUT_WR)
            while stranger.recv(1000):  # until it was dealt with
                pass
    assert not caplog.records


def test_no_page_makes_itself_public(server):
    assert server._server.request_share_url() is None


def test_rather_no_viewer_than_an_open_one():
    stopped = threading.Event()

    class Other:
        stop = stopped.set

    with pytest.raises(BackendUnavailableError, match="every page"):
        start_guarded(Other, "127.0.0.1")
    assert stopped.is_set()
