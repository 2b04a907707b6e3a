"""The page of the receiver in a browser, served over plain HTTP: a few files and the streams, nothing else."""

import asyncio
from types import TracebackType

from splatwire.transport.address import cannot_listen
from splatwire.transport.page_content import PageContent

MOST_HEAD_BYTES = 8192
MOST_AT_ONCE = 256
PATIENCE_S = 5.0
SLOWEST_BYTES_S = 4096
"""A client that takes fewer bytes a second is not waited for."""


class PageServer:
    """Serves the page until it is closed; use it as an asynchronous context.

    A browser lets a page open WebTransport sessions only if it came from this machine or over HTTPS; to a page from
    elsewhere the stream comes by HTTP.

    Args:
        content: What is served.
        port: TCP port; 0 lets the system choose.

    Raises:
        InvalidValueError: If it is taken.
    """

    def __init__(self, content: PageContent, port: int = 0) -> None:
        self._content = content
        self._wanted = port
        self._server: asyncio.Server | None = None
        self._at_once = 0

    async def __aenter__(self) -> "PageServer":
        host = self._content.host
        try:
            self._server = await asyncio.start_server(self._serve, host, self._wanted, limit=MOST_HEAD_BYTES)
        except OSError as error:
            raise cannot_listen("TCP", host, self._wanted, error) from error
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

    @property
    def url(self) -> str:
        """Address of the page."""
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self._content.host, self._content.host)
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/"

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._at_once += 1
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), PATIENCE_S)
            if self._at_once <= MOST_AT_ONCE:
                answer = await asyncio.to_thread(self._content.answer, head)  # a picture takes its time
                writer.write(answer)
                await asyncio.wait_for(writer.drain(), PATIENCE_S + len(answer) / SLOWEST_BYTES_S)
        except (asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError, OSError):
            pass  # whoever it was wanted no page
        finally:
            self._at_once -= 1
            writer.close()
