"""HTTP/1.1 messages of the server for the browser page: request parser and responses (RFC 9110, RFC 9112)."""

import gzip
import ipaddress
import re
from collections.abc import AsyncIterator, Mapping
from functools import lru_cache
from mmap import mmap
from typing import NamedTuple, Protocol, runtime_checkable

from splatwire.errors import BitstreamError

_REQUEST = re.compile(r"([!#$%&'*+.^_`|~0-9A-Za-z-]+) ([!-~]+) HTTP/1\.([01])")
_ABSOLUTE = re.compile(r"https?://([^/?#]+)([/?]?[!-~]*)", re.IGNORECASE)
_FIELD = re.compile(r"([!#$%&'*+.^_`|~0-9A-Za-z-]+):([\t\x20-\x7e\x80-\xff]*)")
_RANGE = re.compile(r"bytes=([0-9]{0,18})-([0-9]{0,18})", re.IGNORECASE)
_NO_WEIGHT = re.compile(r"q=0(?:\.0{0,3})?")
_HOST = re.compile(r"(\[[0-9A-Fa-f:.]{2,45}\]|[0-9A-Za-z._-]{1,253})(?::[0-9]{0,5})?")
"""Host name or IP address with optional port. Stricter than RFC 3986, so that the text is safe in headers and HTML."""


_BEARER = re.compile(r"[Bb]earer +([A-Za-z0-9._-]+)")
_TOKEN = re.compile(r"(?:^|&)token=([A-Za-z0-9._-]+)(?:&|$)")


class Request(NamedTuple):
    """Head of an HTTP request.

    Attributes:
        method: Request method.
        target: Path of the URL, percent-encoded.
        query: Query string: the part of the URL after the question mark.
        host: Host of the `Host` header without port; empty without the header.
        headers: Header values by lower-case name; the values of a repeated header are joined by commas.
    """

    method: str
    target: str
    query: str
    host: str
    headers: Mapping[str, str]


@runtime_checkable
class GrowingFile(Protocol):
    """Stream file of unknown length that is still being received."""

    def pieces(self) -> AsyncIterator[bytes]:
        """Yields the bytes of the file piece by piece during reception."""


class Response(NamedTuple):
    """HTTP response: bytes of the head, and the body."""

    head: bytes
    body: bytes | memoryview | GrowingFile

    def for_method(self, method: str) -> "Response":
        """Returns the response for a request method, without body for HEAD."""
        return self._replace(body=b"") if method == "HEAD" else self


def read_request(head: bytes) -> Request:
    """Parses the head of an HTTP request (RFC 9112, 3.2).

    Args:
        head: Bytes of the request line and the headers, with or without the final empty line.

    Raises:
        BitstreamError: If the head has a control byte within a line or a header without name, or the length of the
            request's body is ambiguous. Also if there is not exactly one valid `Host` header; HTTP/1.0 may omit it.
    """
    first, *lines = head.removesuffix(b"\r\n\r\n").decode("latin-1").split("\r\n")
    words, headers = _REQUEST.fullmatch(first), dict[str, str]()
    if words is None:
        raise BitstreamError("no request of HTTP/1")
    for line in lines:
        field = _FIELD.fullmatch(line)
        if field is None or (field[1].lower() == "host" and "host" in headers):
            raise BitstreamError(f"no header of a request: {line[:80]!r}")
        name, value = field[1].lower(), field[2].strip(" \t")
        headers[name] = f"{headers[name]}, {value}" if name in headers else value
    _check_body_length(headers, words[3])
    is_without_host = words[3] == "0" and "host" not in headers
    host, path = "" if is_without_host else _host(headers.get("host", "")), words[2]
    if absolute := _ABSOLUTE.fullmatch(path):
        host, path = _host(absolute[1]), absolute[2] if absolute[2].startswith("/") else f"/{absolute[2]}"
    if not path.startswith("/") and (words[1], path) != ("OPTIONS", "*"):
        raise BitstreamError(f"no URL of a request: {path[:80]!r}")
    target, _, query = path.partition("?")
    return Request(words[1], target, query, host, headers)


def _check_body_length(headers: Mapping[str, str], minor: str) -> None:
    """Checks that the length of a request's body is unambiguous (RFC 9112, 6.1 and 6.3), against request smuggling.

    Raises:
        BitstreamError: If the length is invalid or stated twice.
    """
    length, coding = headers.get("content-length"), headers.get("transfer-encoding")
    if length is not None and not re.fullmatch(r"([0-9]{1,18})(?:[ \t]*,[ \t]*\1)*", length):
        raise BitstreamError(f"no length of a body: {length[:80]!r}")
    if coding is not None and (
        length is not None or minor == "0" or not re.fullmatch(r"(?i)(?:.*[ \t,])?chunked", coding)
    ):
        raise BitstreamError(f"a body of unclear length: Transfer-Encoding {coding[:80]!r}")


def _host(text: str) -> str:
    """Returns the host from the value `HOST[:PORT]` of a `Host` header."""
    match = _HOST.fullmatch(text)
    if match is None:
        raise BitstreamError(f"no host: {text[:80]!r}")
    if match[1].startswith("["):
        try:
            ipaddress.IPv6Address(match[1][1:-1])
        except ValueError as error:
            raise BitstreamError(f"no IPv6 address: {text[:80]!r}") from error
    return match[1]


def token_of(request: Request) -> str:
    """Returns the access token in the `Authorization` header or the query of a request; empty without one."""
    match = _BEARER.fullmatch(request.headers.get("authorization", ""))
    return match[1] if match else token_in(request.query)


def token_in(query: str) -> str:
    """Returns the access token in a query string; empty without one."""
    match = _TOKEN.search(query)
    return match[1] if match else ""


def accepts_gzip(text: str) -> bool:
    """Returns True if the value of an `Accept-Encoding` header accepts gzip (RFC 9110, 12.5.3)."""
    for coding in text.lower().split(","):
        name, *parameters = (word.strip(" \t") for word in coding.split(";"))
        if name in ("gzip", "x-gzip"):
            return not any(_NO_WEIGHT.fullmatch(word) for word in parameters)
    return False


@lru_cache(maxsize=8)
def _packed(body: bytes) -> bytes:
    return gzip.compress(body, mtime=0)


def read_range(text: str, size: int) -> tuple[int, int] | None:
    """Parses the value of a `Range` header: the requested byte range of a file (RFC 9110, section 14).

    Args:
        text: Value of the header.
        size: Size of the whole file in bytes.

    Returns:
        Offset of the first requested byte, and offset of the byte after the last requested byte. None if the whole file
        is to be sent.
    """
    match = _RANGE.fullmatch(text)
    if match is None or not (match[1] or match[2]):
        return None
    if not match[1]:
        return max(size - int(match[2]), 0), size
    first, last = int(match[1]), int(match[2]) if match[2] else size - 1
    if last < first and match[2]:
        return None
    return (first, min(last + 1, size)) if first < size else (size, size)


def make_file_response(
    kind: str, body: bytes | mmap, headers: str, request: Request, tag: str, *, packed: bool = False,
    private: bool = False,
) -> Response:  # fmt: skip
    """Returns the response to a GET or HEAD request for a file or a byte range (RFC 9110, sections 13 and 14).

    Args:
        kind: Media type of the file.
        body: Bytes of the file.
        headers: Further header lines, each with its line ending.
        request: Parsed request.
        tag: Entity tag of the file, derived from its content.
        packed: True to compress the body with gzip.
        private: True to forbid shared caches, such as those of proxies, to store the file.
    """
    request_headers = request.headers
    cache = "public, max-age=31536000, immutable" if request.query == tag else "no-cache"
    if private:
        cache = "private, no-cache"
    if packed:
        body, tag, headers = _packed(bytes(body)), f"{tag}-gzip", f"{headers}Content-Encoding: gzip\r\n"
    headers = f'Accept-Ranges: bytes\r\nETag: "{tag}"\r\n{headers}'
    content = body if isinstance(body, bytes) else memoryview(body)
    if not is_current(tag, request_headers.get("if-match", "*"), weak=False):
        return make_response("412 Precondition Failed", headers=headers)
    if is_current(tag, request_headers.get("if-none-match", "")):
        return make_response("304 Not Modified", kind, content, headers, cache=cache, bodiless=True)
    same = request.method == "GET" and request_headers.get("if-range", f'"{tag}"') == f'"{tag}"'
    wanted = read_range(request_headers.get("range", ""), len(body)) if same else None
    if wanted is None:
        return make_response("200 OK", kind, content, headers, cache=cache)
    first, end = wanted
    if first == end:
        return make_response("416 Range Not Satisfiable", headers=f"Content-Range: bytes */{len(body)}\r\n{headers}")
    headers = f"Content-Range: bytes {first}-{end - 1}/{len(body)}\r\n{headers}"
    part = memoryview(body)[first:end]
    return make_response("206 Partial Content", kind, part, headers, cache=cache)


def is_current(tag: str, condition: str, *, weak: bool = True) -> bool:
    """Returns True if a condition on entity tags matches a file (RFC 9110, 13.1.1 and 13.1.2).

    Args:
        tag: Entity tag of the file; empty for a file without one.
        condition: Value of an `If-Match` or `If-None-Match` header: `*` or a list of quoted tags.
        weak: True if a weak tag (`W/"..."`) matches, too.
    """
    listed = [word.strip(" \t") for word in condition.split(",")]
    if weak:
        listed = [word.removeprefix("W/") for word in listed]
    return listed == ["*"] or (bool(tag) and f'"{tag}"' in listed)


def make_response(
    status: str,
    kind: str = "text/plain; charset=utf-8",
    body: bytes | memoryview | GrowingFile = b"",
    headers: str = "",
    *,
    bodiless: bool = False,
    cache: str = "no-store",
) -> Response:
    """Builds an HTTP response.

    Args:
        status: Status code and phrase.
        kind: Media type of the body.
        body: Body of the response. An empty body is replaced by the text of `status`.
        headers: Further header lines, each with its line ending.
        bodiless: True to omit the body but keep its `Content-Length`, as with status 304.
        cache: Value of the `Cache-Control` header.
    """
    if status.startswith("204 "):
        head = f"HTTP/1.1 {status}\r\n{headers}Cache-Control: {cache}\r\nConnection: close\r\n\r\n"
        return Response(head.encode("latin-1"), b"")
    if not isinstance(body, GrowingFile):
        body = body or f"{status}\n".encode()
        headers = f"Content-Length: {len(body)}\r\n{headers}"
    head = (
        f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\n{headers}"
        f"X-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\nCache-Control: {cache}\r\n"
        "Connection: close\r\n\r\n"
    )
    return Response(head.encode("latin-1"), b"" if bodiless else body)
