"""HTTP/1.1 as the page server speaks it: heads of requests, read strictly, and answers (RFC 9110, RFC 9112)."""

import gzip
import ipaddress
import re
from collections.abc import AsyncIterator, Mapping
from functools import lru_cache
from typing import NamedTuple, Protocol, runtime_checkable

from splatwire.errors import BitstreamError

_REQUEST = re.compile(r"([!#$%&'*+.^_`|~0-9A-Za-z-]+) (/[!-~]*) HTTP/1\.[01]")
_FIELD = re.compile(r"([!#$%&'*+.^_`|~0-9A-Za-z-]+):([\t\x20-\x7e\x80-\xff]*)")
_RANGE = re.compile(r"bytes=([0-9]{0,18})-([0-9]{0,18})")
_HOST = re.compile(r"(\[[0-9A-Fa-f:.]{2,45}\]|[0-9A-Za-z._-]{1,253})(?::[0-9]{0,5})?")
"""A number or a name, and a port. RFC 3986 lets names have `%` and more, no host has them; what passes here may stand
in headers and in markup as it is."""


class Request(NamedTuple):
    """The head of a request.

    Attributes:
        method: Its method.
        target: Path, still percent-encoded.
        query: What is behind the question mark.
        host: Host by which the server was called, without a port; an IPv6 address keeps its brackets.
        headers: Values by name in lower case.
    """

    method: str
    target: str
    query: str
    host: str
    headers: Mapping[str, str]


@runtime_checkable
class Growing(Protocol):
    """A stream's file of which more comes."""

    def pieces(self) -> AsyncIterator[bytes]:
        """The file from its beginning, piece by piece, until its end."""


class Answer(NamedTuple):
    """What is sent back: a head and a body, of which answers share every part; without a length where it grows."""

    head: bytes
    body: bytes | memoryview | Growing


def read_request(head: bytes) -> Request:
    """Reads the head of a request.

    Args:
        head: Its bytes; the empty line at the end may be there.

    Raises:
        BitstreamError: If it is none: a control byte anywhere but between lines, a field without a name, no host or
            two, an impossible host.
    """
    first, *lines = head.removesuffix(b"\r\n\r\n").decode("latin-1").split("\r\n")
    words, headers = _REQUEST.fullmatch(first), dict[str, str]()
    if words is None:
        raise BitstreamError("no request of HTTP/1")
    for line in lines:
        field = _FIELD.fullmatch(line)
        if field is None or (field[1].lower() == "host" and "host" in headers):
            raise BitstreamError(f"no header of a request: {line[:80]!r}")
        headers[field[1].lower()] = field[2].strip(" \t")
    target, _, query = words[2].partition("?")
    return Request(words[1], target, query, _host(headers.get("host", "")), headers)


def _host(text: str) -> str:
    """The host of `HOST[:PORT]`."""
    match = _HOST.fullmatch(text)
    if match is None:
        raise BitstreamError(f"no host: {text[:80]!r}")
    if match[1].startswith("["):
        try:
            ipaddress.IPv6Address(match[1][1:-1])
        except ValueError as error:
            raise BitstreamError(f"no IPv6 address: {text[:80]!r}") from error
    return match[1]


@lru_cache(maxsize=8)
def _packed(body: bytes) -> bytes:
    return gzip.compress(body, mtime=0)


def read_range(text: str, size: int) -> tuple[int, int] | None:
    """The bytes that a header `Range` asks for, as their first and the one behind the last (RFC 9110, 14).

    Args:
        text: The header's value; one that is no single range of bytes is ignored, as RFC 9110 says.
        size: Bytes of the whole.

    Returns:
        None for the whole; an empty range where nothing of it is there.
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


def make_part(kind: str, body: bytes, headers: str, request: Request, tag: str, *, packed: bool = False) -> Answer:
    """The part of a file that a request asks for, or the whole of it, or that it has not changed.

    What is asked for under its tag (`?TAG`) never changes; caches ask again about everything else.

    Args:
        kind: Media type.
        body: The file.
        headers: Further lines, each with its end.
        request: What is asked for.
        tag: Names this content and no other.
        packed: Whether the body is compressed with gzip; it has a tag of its own then.
    """
    asked, bodiless = request.headers, request.method == "HEAD"
    cache = "public, max-age=31536000, immutable" if request.query == tag else "no-cache"
    if packed:
        body, tag, headers = _packed(body), f"{tag}-gzip", f"{headers}Content-Encoding: gzip\r\n"
    headers = f'Accept-Ranges: bytes\r\nETag: "{tag}"\r\n{headers}'
    if f'"{tag}"' in asked.get("if-none-match", ""):
        return make_answer("304 Not Modified", kind, body, headers, cache=cache, bodiless=True)
    same = asked.get("if-range", f'"{tag}"') == f'"{tag}"'
    wanted = read_range(asked.get("range", ""), len(body)) if same else None
    if wanted is None:
        return make_answer("200 OK", kind, body, headers, bodiless=bodiless, cache=cache)
    first, end = wanted
    if first == end:
        return make_answer("416 Range Not Satisfiable", headers=f"Content-Range: bytes */{len(body)}\r\n{headers}")
    headers = f"Content-Range: bytes {first}-{end - 1}/{len(body)}\r\n{headers}"
    part = memoryview(body)[first:end]
    return make_answer("206 Partial Content", kind, part, headers, bodiless=bodiless, cache=cache)


def make_answer(
    status: str,
    kind: str = "text/plain; charset=utf-8",
    body: bytes | memoryview | Growing = b"",
    headers: str = "",
    *,
    bodiless: bool = False,
    cache: str = "no-store",
) -> Answer:
    """Puts an answer together.

    Args:
        status: Code and phrase.
        kind: Media type of the body.
        body: The body; where it is empty, the status. One that grows ends where the connection does.
        headers: Further lines, each with its end.
        bodiless: Whether the body is left out (HEAD); its size is told nevertheless.
        cache: What others may do with it.
    """
    if not isinstance(body, Growing):
        body = body or f"{status}\n".encode()
        headers = f"Content-Length: {len(body)}\r\n{headers}"
    head = (
        f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\n{headers}"
        f"X-Content-Type-Options: nosniff\r\nReferrer-Policy: no-referrer\r\nCache-Control: {cache}\r\n"
        "Connection: close\r\n\r\n"
    )
    return Answer(head.encode("latin-1"), b"" if bodiless else body)
