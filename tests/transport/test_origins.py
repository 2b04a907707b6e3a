"""Pages of other sites, other names, proxies and caches: who may read a stream, and which address a page gets."""

import pytest

from splatwire.errors import InvalidValueError
from splatwire.transport.origins import is_loopback, is_loopback_origin, parse_origin
from splatwire.transport.page_content import Link, PageContent
from splatwire.view.page import _origins

TARGETS = ("/streams/ball.swz", "/streams.json", "/splatwire.js", "/splatwire-view.js")
LOCAL = ("http://localhost:5173", "http://127.0.0.1:8888", "https://[::1]:1", "http://app.localhost")
FOREIGN = (
    "https://evil.example", "null", "http://localhost.evil.example", "http://127.0.0.1.evil.example", "http://10.0.0.1",
    "http://evil.example:127", "file://", "http://localhost:5173/x", "http://user@localhost", "HTTP://localhost\t", "",
)  # fmt: skip


def asked(content, target="/streams/ball.swz", origin=None, host="127.0.0.1:8080", more=""):
    line = "" if origin is None else f"Origin: {origin}\r\n"
    head = content.answer(f"GET {target} HTTP/1.1\r\nHost: {host}\r\n{line}{more}\r\n".encode()).head.decode()
    status, *lines = head.rstrip("\r\n").split("\r\n")
    found = {}
    for text in lines:
        name, _, value = text.partition(": ")
        found[name] = f"{found[name]}, {value}" if name in found else value
    return int(status.split()[1]), found


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "::1", "127.3.2.1"])
def test_on_loopback_only_pages_of_this_machine_may_read(target, host):
    content = PageContent({"ball": b"scene"}, host=host)
    for origin in FOREIGN:
        code, headers = asked(content, target, origin)
        assert (code, headers.get("Access-Control-Allow-Origin")) in ((200, None), (400, None)), origin
    for origin in LOCAL:
        assert asked(content, target, origin)[1]["Access-Control-Allow-Origin"] == origin
    for origin in (*LOCAL, "https://evil.example", None):
        assert "Origin" in asked(content, target, origin)[1]["Vary"]


@pytest.mark.parametrize("target", TARGETS)
def test_a_server_for_others_is_for_all_pages(target):
    for content in (
        PageContent({"ball": b"scene"}, host="0.0.0.0"),
        PageContent({"ball": b"scene"}, public_origin="https://a.org"),
    ):
        for origin in (None, "https://b.org", "null"):
            assert asked(content, target, origin, "10.0.0.1")[1]["Access-Control-Allow-Origin"] == "*"


@pytest.mark.parametrize("more", ["", "Range: bytes=0-1\r\n", "Range: bytes=99-\r\n", "If-None-Match: TAG\r\n"])
def test_with_origins_caches_keep_answers_to_different_pages_apart(more):
    content = PageContent({"ball": b"scene"}, host="0.0.0.0", origins=("https://a.org",))
    more = more.replace("TAG", asked(content)[1]["ETag"])
    for origin in (None, "https://a.org", "https://b.org", "http://localhost", "null"):
        code, headers = asked(content, origin=origin, more=more)
        assert headers["Vary"] == "Origin", (code, origin)
        assert headers.get("Access-Control-Allow-Origin") == ("https://a.org" if origin == "https://a.org" else None)


def test_packed_and_plain_scripts_are_kept_apart_by_caches():
    content = PageContent({}, host="0.0.0.0")
    for more in ("", "Accept-Encoding: gzip\r\n"):
        assert asked(content, "/splatwire.js", more=more)[1]["Vary"] == "Accept-Encoding"


def test_a_proxy_may_pass_the_public_name_or_that_of_the_server():
    content = PageContent(
        {"ball": b"scene"}, Link(4840, "/splatwire", None), public_origin="https://splats.example.org"
    )
    for host in ("splats.example.org", "SPLATS.example.org:443", "127.0.0.1:8080", "localhost"):
        assert asked(content, "/", host=host)[0] == 200
    for host in ("example.org", "evil.example", "splats.example.org.evil.example"):
        assert asked(content, "/", host=host)[0] == 403
    assert asked(PageContent({}), "/", host="splats.example.org")[0] == 403


@pytest.mark.parametrize("host", ["127.0.0.1:8080", "10.0.0.1", "[::1]:80", "localhost"])
def test_the_page_is_the_same_by_whatever_name_it_is_asked_for(host):
    """A proxy may ask by an address that no visitor knows."""
    content = PageContent({"ball": b"scene"}, Link(4840, "/splatwire", "ab" * 32))
    answer = content.answer(f"GET / HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
    assert answer == content.answer(b"GET / HTTP/1.1\r\nHost: 192.168.1.1\r\n\r\n")
    assert b'session=":4840/splatwire"' in answer.body


def test_a_viewer_for_other_machines_is_for_no_other_page():
    assert [_origins(host) for host in ("127.0.0.1", "localhost", "0.0.0.0", "10.0.0.1", "::")] == [
        None,
        None,
        (),
        (),
        (),
    ]


def test_origins_are_written_as_browsers_send_them():
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


def test_loopback_is_this_machine_and_nothing_else():
    assert all(map(is_loopback, ("localhost", "LOCALHOST", "127.0.0.1", "127.9.9.9", "::1", "[::1]", "a.localhost")))
    assert not any(map(is_loopback, ("0.0.0.0", "::", "10.0.0.1", "localhost.org", "notlocalhost", "128.0.0.1", "")))
    assert not is_loopback_origin(None)
