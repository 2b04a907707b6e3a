"""Other origins, host names, proxies and caches: access to a stream, and the addresses in a page."""

from http import HTTPStatus

import pytest

from splatwire.errors import InvalidValueError
from splatwire.transport.http import origins
from splatwire.transport.http.content import PageContent, WebTransportEndpoint
from splatwire.transport.http.origins import is_loopback, is_loopback_origin, listens_on_loopback, parse_origin
from splatwire.view.page import _origins

TARGETS = ("/streams/ball.swz", "/streams.json", "/splatwire.js", "/splatwire-view.js")
LOCAL = ("http://localhost:5173", "http://127.0.0.1:8888", "https://[::1]:1", "http://app.localhost")
FOREIGN = (
    "https://evil.example", "null", "http://localhost.evil.example", "http://127.0.0.1.evil.example", "http://10.0.0.1",
    "http://evil.example:127", "file://", "http://localhost:5173/x", "http://user@localhost", "HTTP://localhost\t", "",
)  # fmt: skip


def asked(content, target="/streams/ball.swz", origin=None, host="127.0.0.1:8080", more=""):
    line = "" if origin is None else f"Origin: {origin}\r\n"
    head = content.respond_now(f"GET {target} HTTP/1.1\r\nHost: {host}\r\n{line}{more}\r\n".encode()).head.decode()
    status, *lines = head.rstrip("\r\n").split("\r\n")
    found = {}
    for text in lines:
        name, _, value = text.partition(": ")
        found[name] = f"{found[name]}, {value}" if name in found else value
    return int(status.split()[1]), found


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1", "127.3.2.1"])
def test_loopback_server_allows_local_origins_only(target, host):
    content = PageContent({"ball": b"scene"}, host=host)
    for origin in FOREIGN:
        code, headers = asked(content, target, origin)
        assert (code, headers.get("Access-Control-Allow-Origin")) in ((200, None), (400, None)), origin
    for origin in LOCAL:
        assert asked(content, target, origin)[1]["Access-Control-Allow-Origin"] == origin
    for origin in (*LOCAL, "https://evil.example", None):
        assert "Origin" in asked(content, target, origin)[1]["Vary"]


@pytest.mark.parametrize("target", TARGETS)
def test_name_of_a_loopback_address_counts_as_one(target, monkeypatch):
    """Debian gives the name of the machine the address 127.0.1.1."""
    addresses = {
        "machine": ["127.0.1.1"], "127.1": ["127.0.0.1"], "both": ["127.0.0.1", "::1"],
        "some": ["127.0.0.1", "10.0.0.1"],
    }  # fmt: skip
    monkeypatch.setattr(
        "socket.getaddrinfo", lambda host, *_, **__: [(2, 1, 6, "", (found, 0)) for found in addresses[host]]
    )
    for host in addresses:
        content = PageContent({"ball": b"scene"}, host=host)
        allowed = asked(content, target, "https://evil.example")[1].get("Access-Control-Allow-Origin")
        assert allowed == ("*" if host == "some" else None), host


@pytest.fixture(autouse=True)
def without_cached_names():
    origins._resolves_to_loopback.cache_clear()
    yield
    origins._resolves_to_loopback.cache_clear()


def test_a_name_that_could_not_be_resolved_once_is_resolved_again_later(monkeypatch):
    def failing(*_, **__):
        raise OSError("temporary failure in name resolution")

    with monkeypatch.context() as patched:
        patched.setattr("socket.getaddrinfo", failing)
        assert not listens_on_loopback("machine")
    monkeypatch.setattr(origins, "RESOLVED_FOR_S", 1e-9)
    monkeypatch.setattr("socket.getaddrinfo", lambda *_, **__: [(2, 1, 6, "", ("127.0.1.1", 0))])
    assert listens_on_loopback("machine")


@pytest.mark.parametrize("target", TARGETS)
def test_public_server_allows_every_origin(target):
    for content in (
        PageContent({"ball": b"scene"}, host="0.0.0.0"),
        PageContent({"ball": b"scene"}, public_origin="https://a.org"),
    ):
        for origin in (None, "https://b.org", "null"):
            assert asked(content, target, origin, "10.0.0.1")[1]["Access-Control-Allow-Origin"] == "*"


@pytest.mark.parametrize("more", ["", "Range: bytes=0-1\r\n", "Range: bytes=99-\r\n", "If-None-Match: TAG\r\n"])
def test_answers_with_origins_vary_by_origin(more):
    content = PageContent({"ball": b"scene"}, host="0.0.0.0", origins=("https://a.org",))
    more = more.replace("TAG", asked(content)[1]["ETag"])
    for origin in (None, "https://a.org", "https://b.org", "http://localhost", "null"):
        code, headers = asked(content, origin=origin, more=more)
        assert headers["Vary"] == "Origin", (code, origin)
        assert headers.get("Access-Control-Allow-Origin") == ("https://a.org" if origin == "https://a.org" else None)


@pytest.mark.parametrize(
    ("target", "host", "more", "code"),
    [
        ("/streams/ball.swz", "127.0.0.1", "", 200), ("/streams/ball.swz", "127.0.0.1", "Range: bytes=0-1\r\n", 206),
        ("/streams/ball.swz", "127.0.0.1", "Range: bytes=99-\r\n", 416), ("/streams/no.swz", "127.0.0.1", "", 404),
        ("/", "evil.example", "", 403),
    ],
)  # fmt: skip
def test_status_lines_have_the_standard_reason(target, host, more, code):
    content = PageContent({"ball": b"scene"})
    head = content.respond_now(f"GET {target} HTTP/1.1\r\nHost: {host}\r\n{more}\r\n".encode()).head
    reason = "Range Not Satisfiable" if code == 416 else HTTPStatus(code).phrase  # RFC 9110; 416 differs in Python
    assert head.startswith(f"HTTP/1.1 {code} {reason}\r\n".encode())


def test_answers_vary_by_content_encoding():
    content = PageContent({}, host="0.0.0.0")
    for more in ("", "Accept-Encoding: gzip\r\n"):
        assert asked(content, "/splatwire.js", more=more)[1]["Vary"] == "Accept-Encoding"


@pytest.mark.parametrize(("origins", "readable"), [(None, "*"), (("https://a.org",), "https://a.org"), ((), None)])
def test_pages_of_other_origins_see_why_a_stream_is_refused(origins, readable):
    content = PageContent({"ball": b"scene"}, host="0.0.0.0", origins=origins)
    code, headers = asked(content, "/streams/none.swz", "https://a.org")
    assert (code, headers.get("Access-Control-Allow-Origin")) == (404, readable)
    busy = content.busy(
        b"GET /streams/ball.swz HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: https://a.org\r\n\r\n"
    ).head.decode()
    assert busy.startswith("HTTP/1.1 503 ")
    assert "Retry-After: 1\r\n" in busy
    assert (f"Access-Control-Allow-Origin: {readable}\r\n" in busy) == (readable is not None)
    assert content.busy(b"nonsense\r\n\r\n").head.startswith(b"HTTP/1.1 400 ")


def test_proxy_with_another_host_header_is_answered_with_the_right_one():
    content = PageContent({"ball": b"scene"}, public_origin="https://splats.example.org")
    answer = content.respond_now(b"GET / HTTP/1.1\r\nHost: splat_backend\r\n\r\n")
    assert b"Host: splats.example.org" in answer.body
    assert b"--public-url" not in answer.body


@pytest.mark.parametrize(
    ("text", "packed"),
    [
        ("gzip", True), ("br, GZIP;q=0.5", True), ("gzip ; q=0.001", True), ("x-gzip", True), ("", False),
        ("gzip;q=0", False), ("gzip;q=0.000, br", False), ("br;q=1, gzip; q=0.0", False), ("*;q=0", False),
        ("gzipped", False),
    ],
)  # fmt: skip
def test_scripts_are_compressed_only_for_clients_that_accept_it(text, packed):
    headers = asked(PageContent({}), "/splatwire.js", more=f"Accept-Encoding: {text}\r\n")[1]
    assert ("Content-Encoding" in headers) == packed


def test_proxy_host_header_is_accepted():
    content = PageContent(
        {"ball": b"scene"}, WebTransportEndpoint(4840, "/splatwire", None), public_origin="https://splats.example.org"
    )
    for host in ("splats.example.org", "SPLATS.example.org:443", "127.0.0.1:8080", "localhost"):
        assert asked(content, "/", host=host)[0] == 200
    for host in ("example.org", "evil.example", "splats.example.org.evil.example"):
        assert asked(content, "/", host=host)[0] == 403
    assert asked(PageContent({}), "/", host="splats.example.org")[0] == 403


@pytest.mark.parametrize("host", ["127.0.0.1:8080", "10.0.0.1", "[::1]:80", "localhost"])
def test_page_does_not_depend_on_the_host_header(host):
    """A proxy may use an internal address."""
    content = PageContent({"ball": b"scene"}, WebTransportEndpoint(4840, "/splatwire", "ab" * 32))
    answer = content.respond_now(f"GET / HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
    assert answer == content.respond_now(b"GET / HTTP/1.1\r\nHost: 192.168.1.1\r\n\r\n")
    assert b'session=":4840/splatwire"' in answer.body


def test_public_viewer_allows_no_other_origin():
    assert [_origins(host) for host in ("127.0.0.1", "localhost", "0.0.0.0", "10.0.0.1", "::")] == [
        None,
        None,
        (),
        (),
        (),
    ]


def test_origins_are_normalised_as_browsers_send_them():
    for text, origin in (
        ("https://a.org", "https://a.org"), ("https://A.org/", "https://a.org"), (" http://a.org:80 ", "http://a.org"),
        ("https://a.org:0443", "https://a.org"), ("http://[::1]:8080", "http://[::1]:8080"),
    ):  # fmt: skip
        assert parse_origin(text) == origin
    for text in (
        "",
        "a.org",
        "https://a.org/path",
        "ftp://a.org",
        "https://a.org:99999",
        "*",
        "https://u@a.org",
        "null",
    ):
        with pytest.raises(InvalidValueError, match="not a web origin"):
            parse_origin(text)


def test_only_loopback_addresses_are_loopback():
    assert all(map(is_loopback, ("localhost", "LOCALHOST", "127.0.0.1", "127.9.9.9", "::1", "[::1]", "a.localhost")))
    assert not any(map(is_loopback, ("0.0.0.0", "::", "10.0.0.1", "localhost.org", "notlocalhost", "128.0.0.1", "")))
    assert not is_loopback_origin(None)
