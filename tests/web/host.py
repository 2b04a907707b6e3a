"""A third-party web site with the element: its pages, its server, and interrupted transfers."""

import asyncio
import contextlib
import threading
from collections.abc import AsyncIterator, Awaitable, Callable

from splatwire.transport.http.content import web_file
from splatwire.transport.http.messages import Request, read_range, read_request

WATCH = """<script>
window.workers = 0;
const Plain = Worker, end = Worker.prototype.terminate, contexts = [], urls = new Set(), watching = new Set();
window.Worker = class extends Plain { constructor(...given) { super(...given); window.workers++; } };
Worker.prototype.terminate = function () { window.workers--; end.call(this); };
const around = (owner, name, after) => {
  const plain = owner[name];
  owner[name] = function (...given) { const made = plain.apply(this, given); after(this, made, given); return made; };
};
for (const canvas of [HTMLCanvasElement, OffscreenCanvas])
  around(canvas.prototype, "getContext", (_, made, [kind]) => {
    if (made && kind.startsWith("webgl") && !contexts.some((one) => one.deref() === made))
      contexts.push(new WeakRef(made));
  });
around(URL, "createObjectURL", (_, made) => urls.add(made));
around(URL, "revokeObjectURL", (_, __, [url]) => urls.delete(url));
for (const observer of [ResizeObserver, IntersectionObserver, MutationObserver]) {
  around(observer.prototype, "observe", (one) => watching.add(one));
  around(observer.prototype, "disconnect", (one) => watching.delete(one));
}
window.alive = () => ({
  contexts: contexts.filter((one) => one.deref()?.isContextLost() === false).length,
  workers: window.workers, urls: urls.size, observers: watching.size,
});
window.events = [];
for (const kind of ["progress", "firstpicture", "load", "error", "lost"])
  document.addEventListener(kind, ({target, detail}) => {
    if (target.localName === "splat-wire") events.push([kind, detail]);
  }, true);
</script>"""
"""Counts open WebGL contexts, workers, blob addresses and observers, and records events."""

Deliver = Callable[[Request, bytes], int | None]
"""Bytes of a stream's answer before the connection is cut; 0 for no answer, None for all."""


class Host:
    """Requests and the bytes sent for each; `deliver` may change during operation."""

    def __init__(self, pages: dict[str, str], streams: dict[str, bytes], scripts: dict[str, str]) -> None:
        self.pages, self.streams, self.scripts = pages, streams, scripts
        self.deliver: Deliver = lambda request, body: None
        self.ranges = True
        """False for a server that ignores ranges."""
        self.busy: dict[str, int] = {}
        """Number of requests for a script that are still refused, as by a full server."""
        self.asked: list[Request] = []
        self.cut = threading.Event()
        self.sent = 0
        self.port = 0

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/"

    async def answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            request = read_request(await reader.readuntil(b"\r\n\r\n"))
            answer, cut = self._bytes(request)
            writer.write(answer)
            await writer.drain()
            if cut:  # after the page has it: a browser may discard data of a broken connection
                await asyncio.to_thread(self.cut.wait, 120)
        except (asyncio.IncompleteReadError, ConnectionError):
            pass  # a browser that opens connections without need
        finally:
            writer.close()

    def _bytes(self, request: Request) -> tuple[bytes, bool]:
        """Data to send for a request; and True if the connection then stays open until it is cut."""
        name = request.target[1:]
        if name in self.streams:
            return self._stream(request, self.streams[name])
        if self.busy.get(name, 0) > 0:
            self.busy[name] -= 1
            return _answer("503 Service Unavailable", "text/plain", b"busy"), False
        if name in ("splatwire.js", "splatwire-view.js"):
            return _answer("200 OK", "text/javascript", web_file(name).encode()), False
        if name in self.scripts:
            return _answer("200 OK", "text/javascript", self.scripts[name].encode()), False
        if name in self.pages:
            text = f"<!doctype html>{WATCH}{self.pages[name]}"
            return _answer("200 OK", "text/html; charset=utf-8", text.encode()), False
        return _answer("404 Not Found", "text/plain", b"none"), False

    def _stream(self, request: Request, file: bytes) -> tuple[bytes, bool]:
        self.asked.append(request)
        wanted = read_range(request.headers.get("range", ""), len(file)) if self.ranges else None
        first, end = wanted or (0, len(file))
        body, status = file[first:end], "206 Partial Content" if wanted else "200 OK"
        answer, most = _answer(status, "application/octet-stream", body), self.deliver(request, body)
        head = len(answer) - len(body)
        if most is None:
            self.sent += len(body)
            return answer, False
        self.sent += most
        return answer[: head + most] if most else b"", most > 0


def _answer(status: str, kind: str, body: bytes) -> bytes:
    head = f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\nConnection: close\r\n\r\n"
    return head.encode() + body


@contextlib.asynccontextmanager
async def hosting(
    pages: dict[str, str], streams: dict[str, bytes], scripts: dict[str, str] | None = None
) -> AsyncIterator[Host]:
    """Serves pages, streams and scripts by name."""
    host = Host(pages, streams, scripts or {})
    async with listening(host.answer) as host.port:
        yield host


@contextlib.asynccontextmanager
async def listening(
    answer: Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]],
) -> AsyncIterator[int]:
    """Serves connections on a port, and ends them all at the exit: a browser keeps some open for later requests."""
    writers = []

    async def begin(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writers.append(writer)
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
            await answer(reader, writer)

    async with await asyncio.start_server(begin, "127.0.0.1", 0) as server:
        yield server.sockets[0].getsockname()[1]
    for _ in range(5):  # a connection that was accepted just before begins in one of the next turns
        for writer in writers:
            writer.transport.abort()
        await asyncio.sleep(0)
