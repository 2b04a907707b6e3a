"""The page of the receiver in a browser, served over plain HTTP on loopback: a few files and nothing else."""

import asyncio
from importlib.resources import files
from types import TracebackType
from urllib.parse import urlencode

from splatwire.transport.address import cannot_listen

FILES = {"/": ("index.html", "text/html"), "/receiver.js": ("receiver.js", "text/javascript")}
MOST_HEAD_BYTES = 8192
PATIENCE_S = 5.0


class PageServer:
    """Serves the page until it is closed; use it as an asynchronous context.

    Only to this machine: browsers let pages from elsewhere open a session only if they came over HTTPS.

    Args:
        port: TCP port; 0 lets the system choose.

    Raises:
        InvalidValueError: If it is taken.
    """

    def __init__(self, port: int = 0) -> None:
        self._wanted = port
        self._server: asyncio.Server | None = None

    async def __aenter__(self) -> "PageServer":
        try:
            self._server = await asyncio.start_server(_answer, "127.0.0.1", self._wanted, limit=MOST_HEAD_BYTES)
        except OSError as error:
            raise cannot_listen("TCP", "127.0.0.1", self._wanted, error) from error
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._server is not None:
            self._server.close()

    @property
    def port(self) -> int:
        """The port that it listens on."""
        assert self._server is not None
        return int(self._server.sockets[0].getsockname()[1])

    def url(self, **fields: str) -> str:
        """Address of the page with its form filled in; with `go="1"` it begins at once."""
        return f"http://127.0.0.1:{self.port}/#{urlencode(fields)}"


def response(head: bytes) -> bytes:
    """What a request gets for an answer."""
    words = head.split(b"\r\n", 1)[0].split(b" ")
    if len(words) != 3 or not words[2].startswith(b"HTTP/1."):
        return _response("400 Bad Request")
    if words[0] not in (b"GET", b"HEAD"):
        return _response("405 Method Not Allowed")
    found = FILES.get(words[1].split(b"?")[0].decode("ascii", "replace"))
    if found is None:
        return _response("404 Not Found")
    name, kind = found
    body = files("splatwire.transport").joinpath("web").joinpath(name).read_bytes()
    return _response("200 OK", kind, body, bodiless=words[0] == b"HEAD")


def _response(status: str, kind: str = "text/plain", body: bytes = b"", bodiless: bool = False) -> bytes:
    body = body or f"{status}\n".encode()
    head = (
        f"HTTP/1.1 {status}\r\nContent-Type: {kind}; charset=utf-8\r\nContent-Length: {len(body)}\r\n"
        "X-Content-Type-Options: nosniff\r\nCache-Control: no-store\r\nConnection: close\r\n\r\n"
    )
    return head.encode() + (b"" if bodiless else body)


async def _answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    try:
        head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), PATIENCE_S)
        writer.write(response(head))
        await asyncio.wait_for(writer.drain(), PATIENCE_S)
    except (asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError, OSError):
        pass  # whoever it was wanted no page
    finally:
        writer.close()
