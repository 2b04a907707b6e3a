"""A published folder on a plain file server, in Chromium with its content security policy."""

import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote

import pytest

from explicit import encode_splats
from splatwire.files.atomic_write import atomic_write
from splatwire.transport.http.publish import PublishedScene, published_files
from transport.chromium import executable, isolated_page
from web.pictures import ELEMENT
from web.test_page import SMALL, ball

pytestmark = [pytest.mark.skipif(executable() is None, reason="Chromium is not installed"), pytest.mark.slow]
REQUESTS: list[tuple[int, str]] = []


class Handler(SimpleHTTPRequestHandler):
    """File server without byte ranges and without special headers; records status and path of each request."""

    def log_request(self, code="-", size="-"):
        REQUESTS.append((int(code), self.path))

    def log_message(self, *_):
        """Logs nothing."""


@pytest.mark.parametrize("folder", ["", "deep/below"])
def test_pages_draw_complete_and_verified_scenes_from_files_alone(tmp_path: Path, folder: str) -> None:
    stream = encode_splats(ball(), SMALL)
    files = published_files({"first": PublishedScene(stream), "a room": PublishedScene(stream)})
    for path, data in files.items():
        atomic_write(tmp_path / folder / path, data, parents=True)
    REQUESTS.clear()
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(tmp_path))) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            with isolated_page() as page:
                for name in ("index.html", "a room.html"):
                    base = f"http://127.0.0.1:{server.server_address[1]}/{folder}{'/' * bool(folder)}"
                    page.open(base + quote(name))
                    status = f"{ELEMENT} && {ELEMENT}.status"
                    page.wait_for(f"location.href.endsWith('{quote(name)}') && {status} && {ELEMENT}.view")
                    page.wait_for(f"{ELEMENT}.status.complete && {ELEMENT}.status.verified")
                    assert page.resolve(f"{ELEMENT}.verify()") is True
                assert page.evaluate("document.querySelectorAll('nav a').length") == 2
        finally:
            server.shutdown()
            thread.join()
    assert [request for request in REQUESTS if request[0] >= 400] == []
