"""Streams behind redirects: to the same server, to a store with CORS or with signed URLs, and to one without CORS."""

import contextlib
import itertools
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from splatwire.transport.http.content import web_file
from splatwire.transport.http.messages import read_range
from transport.chromium import Browser, executable, isolated_page
from web.pictures import ELEMENT

pytestmark = [pytest.mark.skipif(executable() is None, reason="Chromium is not installed"), pytest.mark.slow]
GOLDEN = Path(__file__).parent.parent / "golden"
STATUS = f"{ELEMENT}?.status"
PAGE = '<!doctype html><meta charset="utf-8"><script type="module" src="/splatwire.js"></script>'


class Store:
    """Two servers: one of pages, which redirects requests for streams, and one of files.

    Attributes:
        asked: Path of each request for a file.
        is_closed: True while the servers have errors that pages of others may not read.
    """

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.signatures = itertools.count(1)
        self.valid = 0
        self.is_closed = False
        self.pages, self.files = (ThreadingHTTPServer(("127.0.0.1", 0), self._handler(kind)) for kind in "pf")

    def page(self, way: str, name: str) -> str:
        return f"http://127.0.0.1:{self.pages.server_port}/page/{way}/{name}"

    def _handler(self, kind: str) -> type[BaseHTTPRequestHandler]:
        store = self

        class Handler(BaseHTTPRequestHandler):
            def log_message(self, *given: Any) -> None:
                pass

            def do_OPTIONS(self) -> None:
                self.send(204, {"Access-Control-Allow-Headers": "range"})

            def do_HEAD(self) -> None:
                self.do_GET()

            def do_GET(self) -> None:
                words = self.path.split("/")[1:]
                match words:
                    case ["page", way, name]:
                        body = f'{PAGE}<splat-wire src="/{way}/{name}"></splat-wire>'.encode()
                        self.send(200, {"Content-Type": "text/html"}, body)
                    case ["splatwire.js"]:
                        self.send(200, {"Content-Type": "text/javascript"}, web_file("splatwire.js").encode())
                    case ["same", name] if kind == "p":
                        self.send(307, {"Location": f"/file/{name}"})
                    case ["cors" | "closed" as way, name] if kind == "p":
                        self.send(302, {"Location": f"http://localhost:{store.files.server_port}/{way}/{name}"})
                    case ["signed", name] if kind == "p":
                        store.valid = next(store.signatures)
                        place = f"http://localhost:{store.files.server_port}/signed/{store.valid}/{name}"
                        self.send(302, {"Location": place, "Cache-Control": "no-store"})
                    case ["signed", number, name]:  # a signature is valid once
                        is_valid, store.valid = int(number) == store.valid, 0
                        self.file(name) if is_valid else self.send(403)
                    case ["file" | "cors" | "closed", name]:
                        self.file(name)
                    case _:
                        self.send(404)

            def file(self, name: str) -> None:
                store.asked.append(self.path)
                body = (GOLDEN / name).read_bytes()
                wanted = read_range(self.headers.get("Range", ""), len(body))
                if wanted is None:
                    self.send(200, {}, body)
                    return
                first, end = wanted
                self.send(206, {"Content-Range": f"bytes {first}-{end - 1}/{len(body)}"}, body[first:end])

            def send(self, status: int, headers: dict[str, str] | None = None, body: bytes = b"") -> None:
                is_closed = store.is_closed and self.path.startswith("/cors") and kind == "f"
                if is_closed:
                    status, headers, body = 502, {}, b""
                self.send_response(status)
                shared = {} if self.path.startswith("/closed") or is_closed else {"Access-Control-Allow-Origin": "*"}
                for name, value in {"Content-Length": str(len(body)), **shared, **(headers or {})}.items():
                    self.send_header(name, value)
                self.end_headers()
                if self.command != "HEAD":
                    self.wfile.write(body)

        return Handler


@pytest.fixture(scope="module")
def store() -> Iterator[Store]:
    found = Store()
    with contextlib.ExitStack() as stack:
        for server in (found.pages, found.files):
            thread = threading.Thread(target=server.serve_forever)
            thread.start()
            stack.callback(thread.join)
            stack.callback(server.shutdown)
            stack.callback(server.server_close)
        yield found


@pytest.fixture(scope="module")
def page() -> Iterator[Browser]:
    with isolated_page() as opened:
        yield opened


@pytest.mark.parametrize(
    ("way", "name"),
    [
        ("same", "tiny_levels.swz"),
        pytest.param("cors", "tiny_levels.swz", marks=pytest.mark.extended),
        ("cors", "tiny_causal.swz"),
        pytest.param("signed", "tiny_levels.swz", marks=pytest.mark.extended),
        ("signed", "tiny_clip.swz"),
    ],
)
def test_a_stream_behind_a_redirect_arrives_whole(way: str, name: str, store: Store, page: Browser):
    for _ in range(2):  # the second visit has stored packets
        page.open("about:blank")
        page.open(store.page(way, name))
        page.wait_for(f"{STATUS} && ({STATUS}.finished || {STATUS}.failed)")
        assert not page.evaluate(f"{STATUS}.failed")
        assert page.evaluate(f"{STATUS}.complete")


NAMED = f"{STATUS}?.lost?.includes('Access-Control-Allow-Origin')"


def test_a_redirect_to_a_server_without_cors_is_named_by_the_header(store: Store, page: Browser):
    page.open("about:blank")
    store.asked.clear()
    page.open(store.page("closed", "tiny_causal.swz"))
    assert page.wait_for(NAMED)
    assert len(store.asked) < 12


@pytest.mark.parametrize(
    ("visits", "name"),
    [
        pytest.param(0, "tiny_levels.swz", id="fresh-levels"),
        pytest.param(0, "tiny_clip.swz", id="fresh-clip", marks=pytest.mark.extended),
        pytest.param(1, "tiny_levels.swz", id="stored-levels", marks=pytest.mark.extended),
        pytest.param(1, "tiny_causal.swz", id="stored-still"),
        pytest.param(1, "tiny_clip.swz", id="stored-clip"),
    ],
)
def test_a_server_that_loses_cors_for_a_while(name: str, visits: int, store: Store, page: Browser):
    """A stored scene is shown meanwhile. Proxies send errors, such as 502, without the header of their server."""
    visitor = page.another(alone=True)
    try:
        for visit in range(visits + 1):
            store.is_closed = visit == visits
            visitor.open("about:blank")
            visitor.open(store.page("cors", name))
            if not store.is_closed:
                visitor.wait_for(f"{STATUS}?.verified")
        assert visitor.wait_for(NAMED)
        assert visitor.wait_for(f"{STATUS}.gaussians > 0") if visits else visitor.evaluate(f"{STATUS}.gaussians === 0")
        store.is_closed = False
        visitor.wait_for(f"{STATUS}.finished || {STATUS}.failed")
        assert not visitor.evaluate(f"{STATUS}.failed")
        assert visitor.evaluate(f"{STATUS}.complete")
        assert visitor.wait_for(f"{STATUS}.gaussians > 0")
    finally:
        store.is_closed = False
        visitor.close()
