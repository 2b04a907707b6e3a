"""Methods, conditions and names of the page server follow HTTP (RFC 9110) and CORS (Fetch standard)."""

import html
import re
import socket
from urllib.parse import quote, urljoin

import pytest

from splatwire.transport.access import Access
from splatwire.transport.http.content import PageContent
from splatwire.transport.monitoring import MonitoringContent

BODY = bytes(range(200))
LOCAL = PageContent({"city": BODY})
PUBLIC = PageContent({"city": BODY}, host="0.0.0.0")
ONE_ORIGIN = PageContent({"city": BODY}, host="0.0.0.0", origins=("https://a.org",))
STREAM = "/streams/city.swz"


def ask(
    content: PageContent, method: str = "GET", target: str = STREAM, host: str = "127.0.0.1", **headers: str
) -> tuple[int, dict[str, str], bytes]:
    """Status, headers by name and body of a response; underscores in names of headers mean hyphens."""
    lines = [f"{method} {target} HTTP/1.1", f"Host: {host}"]
    lines += [f"{name.replace('_', '-')}: {value}" for name, value in headers.items()]
    answer = content.respond_now(("\r\n".join(lines) + "\r\n\r\n").encode("latin-1"))
    status, *fields = answer.head.decode("latin-1").removesuffix("\r\n\r\n").split("\r\n")
    return int(status.split()[1]), dict(field.split(": ", 1) for field in fields), bytes(answer.body)


TAG = ask(LOCAL)[1]["ETag"]


@pytest.mark.parametrize("target", [STREAM, "/", "/streams.json", "/page.css", "/splatwire.js"])
@pytest.mark.parametrize("method", ["GET", "HEAD"])
def test_if_none_match_with_a_star_is_not_modified(target: str, method: str):
    status, _, body = ask(LOCAL, method, target, If_None_Match="*")
    assert (status, body) == (304, b"")


@pytest.mark.parametrize(
    ("value", "status"),
    [
        (TAG, 304), (f"W/{TAG}", 304), (f'"other", {TAG}', 304), (f'"other" , W/{TAG} ', 304), (f'"a{TAG[1:]}', 200),
        (TAG[1:-1], 200), ('"other"', 200), ("", 200), ("*x", 200),
    ],
)  # fmt: skip
def test_if_none_match_compares_entity_tags(value: str, status: int):
    assert ask(LOCAL, If_None_Match=value)[0] == status


def test_a_missing_stream_is_not_found_whatever_the_condition():
    for name in ("If_None_Match", "If_Match"):
        assert ask(LOCAL, target="/streams/no.swz", **{name: "*"})[0] == 404


@pytest.mark.parametrize(
    ("value", "status"), [("*", 200), (TAG, 200), (f'"x", {TAG}', 200), (f"W/{TAG}", 412), ('"x"', 412)]
)
def test_if_match_compares_entity_tags_strongly(value: str, status: int):
    assert ask(LOCAL, If_Match=value)[0] == status


def test_repeated_headers_are_one_list():
    head = f'GET {STREAM} HTTP/1.1\r\nHost: a\r\nIf-None-Match: {TAG}\r\nIf-None-Match: "x"\r\n\r\n'
    assert PageContent({"city": BODY}, host="a").respond_now(head.encode()).head.startswith(b"HTTP/1.1 304 ")


def test_head_has_the_headers_of_get_and_no_body():
    for target in (STREAM, "/", "/streams.json", "/splatwire.js", "/streams/no.swz"):
        for host in ("127.0.0.1", "evil.example"):
            status, headers, body = ask(LOCAL, "HEAD", target, host)
            found = ask(LOCAL, "GET", target, host)
            assert (status, headers, body) == (*found[:2], b"")
            assert int(headers["Content-Length"]) == len(found[2])
    monitoring = MonitoringContent.__new__(MonitoringContent)
    head = monitoring.respond_now(b"HEAD /none HTTP/1.1\r\nHost: a\r\n\r\n")
    assert head.head.startswith(b"HTTP/1.1 404 ")
    assert head.body == b""


def test_ranges_are_for_get_only():
    assert ask(LOCAL, "GET", Range="bytes=0-9")[0] == 206
    assert ask(LOCAL, "GET", Range="Bytes=0-9")[0] == 206
    status, headers, _ = ask(LOCAL, "HEAD", Range="bytes=0-9")
    assert (status, headers["Content-Length"]) == (200, str(len(BODY)))


@pytest.mark.parametrize(
    "host", ["localhost", "localhost.", "LOCALHOST.", "localhost.:80", "127.0.0.1", "127.0.0.1.", "[::1]",
             "scene.localhost", f"{socket.gethostname()}."]
)  # fmt: skip
def test_names_of_this_machine_are_served(host: str):
    assert ask(LOCAL, target="/", host=host)[0] == 200


@pytest.mark.parametrize("host", ["evil.example", "localhost.evil.example", "localhost..", "notlocalhost", "."])
def test_other_names_are_refused(host: str):
    assert ask(LOCAL, target="/", host=host)[0] == 403


def test_a_public_name_is_served_with_a_final_dot():
    content = PageContent({"city": BODY}, public_origin="https://splats.example")
    assert ask(content, host="splats.example.")[0] == 200


@pytest.mark.parametrize(
    ("target", "status"),
    [
        (f"http://127.0.0.1{STREAM}", 200), (f"http://127.0.0.1:8080{STREAM}?x", 200), ("http://localhost", 200),
        (f"HTTPS://[::1]{STREAM}", 200), ("http://localhost?stream=city", 200), (f"http://evil.example{STREAM}", 403),
        (f"http://user@localhost{STREAM}", 400), ("http:///x", 400), ("ftp://localhost/x", 400), ("localhost/x", 400),
        ("*", 400), ("http://localhost#x", 404), ("http://127.0.0.1/streams/no.swz", 404),
    ],
)  # fmt: skip
def test_the_url_of_a_request_may_be_absolute(target: str, status: int):
    """Its host replaces that of the header, also if that header names this machine (RFC 9112, 3.2.2)."""
    assert ask(LOCAL, target=target)[0] == status
    assert ask(LOCAL, target=target, host="evil.example")[0] == status


@pytest.mark.parametrize("name", ["room (2)", "Küche", "a+b & c, d", "it's", "100%", "50%20"])
def test_a_path_may_be_encoded_in_any_way(name: str):
    """Such as `encodeURIComponent` of JavaScript does, or nginx with a path in `proxy_pass`."""
    content = PageContent({name: BODY, "a": b"other"})
    paths = {
        quote(name, safe=safe) for safe in ("", "!'()*", "!$&'()*+,;=:@")
    } | {"".join(f"%{byte:02x}" for byte in name.encode())}  # fmt: skip
    for path in paths:
        for start, end in (("streams", ".swz"), ("streams", "%2Eswz"), ("%73treams", ".s%77z")):
            assert ask(content, target=f"/{start}/{path}{end}")[::2] == (200, BODY), path
    assert ask(content, target=f"/streams/{quote(quote(name))}x.swz")[0] == 404


def test_the_page_may_be_below_a_path_of_a_proxy():
    """Its links, scripts and streams are relative to its own address."""
    content = PageContent({"city": BODY, "a room": BODY}, public_origin="https://a.org")
    page = ask(content, target="/")[2].decode()
    links = re.findall(r'(?:href|src)="([^"]*)"', page)
    assert {"page.css", "splatwire.js", "?stream=a%20room"} < set(links)
    assert any(link.startswith("streams/city.swz?") for link in links)
    for link in links:
        if not link.startswith("data:"):
            assert urljoin("https://a.org/splats/", link).startswith("https://a.org/splats/"), link
            assert ask(content, target=urljoin("/", html.unescape(link)))[0] == 200, link


def test_an_encoded_path_opens_no_private_scene():
    access = Access(frozenset({"secret"}), problem=lambda token, name: None if token == "good" else "no")
    content = PageContent({"city": BODY, "secret": BODY}, access=access)
    for path in (
        "/private/secret.swz", "/private/%73ecret.swz", "/private/%73%65cret.swz", "/%70rivate/secret.swz",
        "/private/secret%2eswz",
    ):  # fmt: skip
        assert ask(content, target=path)[0] == 401, path
        assert ask(content, target=f"{path}?token=good")[0] == 200, path
    for path in (
        "/streams/secret.swz", "/streams/%73ecret.swz", "/%73treams/secret%2Eswz", "/streams%2Fsecret.swz",
        "/streams/..%2Fprivate%2Fsecret.swz", "/streams/../private/secret.swz", "/private%2Fsecret.swz",
    ):  # fmt: skip
        assert ask(content, target=path)[0] in (401, 404), path


def test_an_absolute_url_and_its_path_have_the_same_answer():
    for path in (STREAM, "/", "/streams.json", "/splatwire.js", "/streams/no.swz"):
        assert ask(LOCAL, target=f"http://localhost{path}") == ask(LOCAL, target=path)


@pytest.mark.parametrize("content", [LOCAL, PUBLIC, ONE_ORIGIN])
@pytest.mark.parametrize("method", ["GET", "HEAD"])
def test_requests_of_http_1_0_need_no_host(content: PageContent, method: str):
    """Health checks of proxies and load balancers send none; HTTP/1.1 requires it."""
    for target, status in (("/", 200), ("/streams.json", 200), (STREAM, 200), ("/none", 404)):
        assert content.respond_now(f"{method} {target} HTTP/1.0\r\n\r\n".encode()).head.split()[1] == b"%d" % status
        assert content.respond_now(f"{method} {target} HTTP/1.1\r\n\r\n".encode()).head.split()[1] == b"400"


@pytest.mark.parametrize("host", ["", "evil.example", "a b"])
def test_a_host_of_http_1_0_is_checked(host: str):
    answer = LOCAL.respond_now(f"GET / HTTP/1.0\r\nHost: {host}\r\n\r\n".encode())
    assert answer.head.split()[1] == (b"403" if host == "evil.example" else b"400")


def test_monitoring_answers_http_1_0_without_a_host():
    monitoring = MonitoringContent.__new__(MonitoringContent)
    assert monitoring.respond_now(b"GET /healthz HTTP/1.0\r\n\r\n").head.startswith(b"HTTP/1.1 200 ")


def test_options_request_may_concern_the_whole_server():
    assert ask(LOCAL, "OPTIONS", "*")[0] == 204


@pytest.mark.parametrize("method", ["GET", "HEAD", "POST"])
@pytest.mark.parametrize(
    "headers",
    [
        {"Content_Length": "4", "Transfer_Encoding": "chunked"}, {"Content_Length": "4, 5"}, {"Content_Length": "-1"},
        {"Content_Length": "+4"}, {"Content_Length": "0x4"}, {"Content_Length": ""}, {"Content_Length": "4 4"},
        {"Transfer_Encoding": "identity"}, {"Transfer_Encoding": "chunked, gzip"}, {"Transfer_Encoding": "xchunked"},
        {"Content_Length": "0", "Transfer_Encoding": "identity"},
    ],
)  # fmt: skip
def test_bodies_of_unclear_length_are_refused(method: str, headers: dict[str, str]):
    """Else a proxy may take the rest of a body for another request."""
    assert ask(LOCAL, method, **headers)[0] == 400


@pytest.mark.parametrize(
    "headers",
    [
        {"Content_Length": "0"}, {"Content_Length": "4"}, {"Content_Length": "4, 4"},
        {"Transfer_Encoding": "chunked"}, {"Transfer_Encoding": "gzip, Chunked"},
    ],
)  # fmt: skip
def test_bodies_of_clear_length_are_ignored(headers: dict[str, str]):
    assert ask(LOCAL, **headers)[0] == 200


def test_an_old_client_has_no_chunked_body():
    head = f"GET {STREAM} HTTP/1.0\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n"
    assert LOCAL.respond_now(head.encode()).head.startswith(b"HTTP/1.1 400 ")


PREFLIGHT = {"Access_Control_Request_Method": "GET", "Access_Control_Request_Headers": "if-range,range"}


@pytest.mark.parametrize(
    ("content", "origin", "allowed"),
    [
        (PUBLIC, "https://b.org", "*"),
        (ONE_ORIGIN, "https://a.org", "https://a.org"),
        (ONE_ORIGIN, "https://b.org", None),
        (LOCAL, "http://localhost:8080", "http://localhost:8080"),
        (LOCAL, "https://b.org", None),
    ],
)
@pytest.mark.parametrize("target", [STREAM, "/streams.json", "/splatwire.js"])
def test_a_preflight_succeeds_exactly_where_a_page_may_read(
    content: PageContent, origin: str, allowed: str | None, target: str
):
    status, headers, body = ask(content, "OPTIONS", target, Origin=origin, **PREFLIGHT)
    assert (status, body) == (204, b"")
    assert headers["Allow"] == "GET, HEAD, OPTIONS"
    assert "Content-Length" not in headers
    assert headers.get("Access-Control-Allow-Origin") == allowed
    assert headers.get("Access-Control-Allow-Origin") == ask(content, "GET", target, Origin=origin)[1].get(
        "Access-Control-Allow-Origin"
    )
    assert ("Vary" in headers) == (content is not PUBLIC)
    if allowed:
        names = {name.strip().lower() for name in headers["Access-Control-Allow-Headers"].split(",")}
        assert {"range", "if-range", "if-none-match", "if-match", "cache-control"} <= names
        assert headers["Access-Control-Allow-Methods"] == "GET, HEAD"
    else:
        assert not any(name.startswith("Access-Control") for name in headers)


def test_options_of_the_page_other_hosts_and_missing_streams():
    status, headers, _ = ask(PUBLIC, "OPTIONS", "/", Origin="https://b.org")
    assert status == 204
    assert "Access-Control-Allow-Methods" not in headers
    assert ask(PUBLIC, "OPTIONS", host="evil.example")[0] == 403
    status, headers, _ = ask(PUBLIC, "OPTIONS", "/streams/no.swz", Origin="https://b.org")
    assert (status, headers["Access-Control-Allow-Origin"]) == (204, "*"), "a preflight reveals no names"
    assert ask(PUBLIC, "GET", "/streams/no.swz", Origin="https://b.org")[0] == 404
    assert ask(PUBLIC, "POST")[1]["Allow"] == "GET, HEAD, OPTIONS"
