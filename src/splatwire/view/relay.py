"""Relay of a transfer from another server to the local page, as a growing `.swz` file."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import TypeAlias

from splatwire.arguments import checked
from splatwire.bitstream import Manifest, file_head, file_record
from splatwire.bitstream.origin import ORIGIN_SECTION
from splatwire.errors import MissingSideInfoError
from splatwire.transport import Event, Finished, PacketArrived, Receiver, SideInfoArrived, Welcomed
from splatwire.transport.http.pack import check_page_support
from splatwire.types.origin import NO_ORIGIN

Receive: TypeAlias = Callable[[Callable[[Event], None]], Awaitable[Receiver]]
"""Function that receives one stream, calls a callback with every event, and returns the finished receiver."""
AT_ONCE = 1 << 16
"""Maximum number of bytes joined for one write to a client; no more is buffered for a slow client."""


class Relay:
    """Receives a stream from another server and passes it on to browser pages while it arrives.

    A page gets the stream as one `.swz` file that grows during the transfer.

    Args:
        url: URL of the stream, for error messages.
        receive: Function that receives the stream and calls back with events.

    Attributes:
        was_live: True if the stream is a live stream, or was one until it ended.
        preview: Preview of the scene; empty before its arrival, or without a preview.
        ending: Event that ended the transfer, with the reason; None while the transfer runs.
        origin: Origin of the scene's coordinates; (0, 0, 0) until the side information is received.
        manifest: Manifest of the stream; None until the side information is received.
    """

    @checked
    def __init__(self, url: str, receive: Receive) -> None:
        self._url, self._receive = url, receive
        self._pieces: list[bytes] = []
        self._changed = asyncio.Condition()
        self._over = self.was_live = False
        self._stream_id: int | None = None
        self._events: asyncio.Queue[Event | None] = asyncio.Queue()
        self._begun, self._headed = asyncio.Event(), asyncio.Event()
        self.preview = b""
        self.ending: Finished | None = None
        self.origin = NO_ORIGIN
        self.manifest: Manifest | None = None

    async def run(self) -> None:
        """Receives the stream until the transfer ends.

        Raises:
            MissingSideInfoError: If the transfer ended before manifest and side information were received.
            SplatwireError: If nothing can be received, the side information is invalid, or browsers cannot decode the
                stream.
        """
        receiving = asyncio.ensure_future(self._receive(self._events.put_nowait))
        receiving.add_done_callback(lambda _: self._events.put_nowait(None))
        tasks = (receiving, asyncio.create_task(self._forward()))
        try:
            await asyncio.gather(*tasks)
            if not self._pieces:
                why = f" ({self.ending.reason})" if self.ending else ""
                raise MissingSideInfoError(f"{self._url}: no scene arrived{why}")
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            async with self._changed:
                self._over = True
                self._changed.notify_all()
            self._begun.set()
            self._headed.set()

    def failure(self) -> str:
        """Returns the reason why a transfer has ended before all data was received.

        The text is empty if the transfer is complete or still running.
        """
        end = self.ending
        wanted = ("complete", "seen", "sent") if self.was_live else ("complete", "seen")
        return "" if end is None or end.reason in wanted else end.reason

    async def begun(self) -> None:
        """Waits until a page can show at least a preview of the scene, or until the transfer has ended."""
        await self._begun.wait()

    async def headed(self) -> None:
        """Waits until the side information (data that all packets need) is received, or the transfer has ended."""
        await self._headed.wait()

    async def pieces(self) -> AsyncIterator[bytes]:
        """Yields the bytes of the stream's `.swz` file piece by piece during the transfer."""
        num_given = 0
        while not self._pieces and not self._over:
            async with self._changed:
                await self._changed.wait()
        pieces = list(self._pieces) if self.was_live else self._pieces
        while num_given < len(pieces) or self._is_growing(pieces):
            while num_given == len(pieces) and self._is_growing(pieces):
                async with self._changed:
                    await self._changed.wait()
            begin, size = num_given, 0
            while num_given < len(pieces) and size < AT_ONCE:
                size, num_given = size + len(pieces[num_given]), num_given + 1
            yield b"".join(pieces[begin:num_given])

    def _is_growing(self, pieces: list[bytes]) -> bool:
        """True if more data may be appended to a `.swz` file.

        The result is False if the transfer has ended, or if the transfer has begun another file since.

        Args:
            pieces: Pieces of the file so far, in order.
        """
        return not self._over and pieces is self._pieces

    async def _forward(self) -> None:
        while (event := await self._events.get()) is not None:
            if isinstance(event, Welcomed):
                self.was_live = event.is_live or self.was_live
                if event.preview:
                    self.preview = event.preview
                    self._begun.set()
            elif isinstance(event, SideInfoArrived):
                check_page_support(event.manifest)
                self.manifest = event.manifest
                self.origin = ORIGIN_SECTION.of_side_info(event.side_info, event.manifest.schema_name)
                await self._begin_file(event.manifest.stream_id, file_head(event.manifest, event.side_info))
                self._begun.set()
                self._headed.set()
            elif isinstance(event, PacketArrived):
                await self._add(file_record(event.packet.data))
            elif isinstance(event, Finished):
                self.ending = event

    async def _begin_file(self, stream_id: int, head: bytes) -> None:
        """Begins a new `.swz` file, or replaces the start of the present file.

        The start is replaced if the present file belongs to the same stream, which is then a live stream that has
        grown.

        Args:
            stream_id: Id of the stream.
            head: First bytes of the file: header, manifest and side information.
        """
        # A live stream gets a new init segment with each group of pictures, which replaces that of its file.
        async with self._changed:
            if stream_id == self._stream_id:
                self._pieces[0] = head
            else:
                self._stream_id, self._pieces = stream_id, [head]
            self._changed.notify_all()

    async def _add(self, piece: bytes) -> None:
        async with self._changed:
            self._pieces.append(piece)
            self._changed.notify_all()
