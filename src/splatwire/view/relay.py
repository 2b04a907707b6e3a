"""A transfer from a server elsewhere, handed on to the page while it arrives: a `.swz` file that grows."""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import TypeAlias

from splatwire.codec import ProgressiveDecoder
from splatwire.errors import MissingSideInfoError
from splatwire.packets import Manifest, Packet, file_head, file_record
from splatwire.transport import Event, PacketArrived, Receiver, SideInfoArrived, Welcomed
from splatwire.view.columns import columns_head, columns_packet, rows_of

Receive: TypeAlias = Callable[[Callable[[Event], None]], Awaitable[Receiver]]
"""Receives one stream and calls back with everything that happens."""
AT_ONCE = 1 << 16
"""Bytes that are put together for one page: all that is kept for one that reads slowly."""


class Relay:
    """Receives a stream, and gives every page that asks all that has arrived, then what still comes.

    What browsers do not decode (format 1) is decoded here, packet by packet, and handed on as columns. Everything
    happens in the event loop that `run` runs in, but for decoding. Of a live clip a page gets the running chapter as it
    is when the page asks: a file has one head, and a live clip gets a new one with each group of frames. One chapter is
    kept.

    Args:
        url: Where from, for messages.
        receive: Receives it.
    """

    def __init__(self, url: str, receive: Receive) -> None:
        self._url, self._receive = url, receive
        self._pieces: list[bytes] = []
        self._changed = asyncio.Condition()
        self._over = self.is_live = False
        self._stream_id: int | None = None
        self._events: asyncio.Queue[Event | None] = asyncio.Queue()
        self._columns: tuple[ProgressiveDecoder, Manifest] | None = None
        self._begun = asyncio.Event()
        self.preview = b""

    async def run(self) -> None:
        """Receives until the transfer ends.

        Raises:
            MissingSideInfoError: If it ended before there was a scene.
            SplatwireError: If nothing can be received, or the side information cannot be read.
        """
        receiving = asyncio.ensure_future(self._receive(self._events.put_nowait))
        receiving.add_done_callback(lambda _: self._events.put_nowait(None))
        tasks = (receiving, asyncio.create_task(self._hand_on()))
        try:
            await asyncio.gather(*tasks)
            if not self._pieces:
                raise MissingSideInfoError(f"{self._url}: no scene arrived")
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            async with self._changed:
                self._over = True
                self._changed.notify_all()
            self._begun.set()

    async def begun(self) -> None:
        """Waits until there is something to look at, a preview or the scene, or all is over."""
        await self._begun.wait()

    async def pieces(self) -> AsyncIterator[bytes]:
        """The file from its beginning, as far as it is there and then as it grows, until the transfer is over."""
        given = 0
        while not self._pieces and not self._over:
            async with self._changed:
                await self._changed.wait()
        pieces = list(self._pieces) if self.is_live else self._pieces
        while given < len(pieces) or self._grows(pieces):
            while given == len(pieces) and self._grows(pieces):
                async with self._changed:
                    await self._changed.wait()
            begin, size = given, 0
            while given < len(pieces) and size < AT_ONCE:
                size, given = size + len(pieces[given]), given + 1
            yield b"".join(pieces[begin:given])

    def _grows(self, pieces: list[bytes]) -> bool:
        """Whether more of a file will come: it is the one that is being received."""
        return not self._over and pieces is self._pieces

    async def _hand_on(self) -> None:
        while (event := await self._events.get()) is not None:
            if isinstance(event, Welcomed):
                self.is_live = event.open or self.is_live
                if event.preview:
                    self.preview = event.preview
                    self._begun.set()
            elif isinstance(event, SideInfoArrived):
                await self._begin_file(event.manifest.stream_id, await asyncio.to_thread(self._head, event))
                self._begun.set()
            elif isinstance(event, PacketArrived):
                await self._add(await asyncio.to_thread(self._record, event.packet))

    async def _begin_file(self, stream_id: int, head: bytes) -> None:
        """Begins the file of another stream, or gives that of a clip that has grown its new head."""
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

    def _head(self, arrived: SideInfoArrived) -> bytes:
        manifest, side_info = arrived.manifest, arrived.side_info
        if not manifest.schema.page:
            decoder = ProgressiveDecoder(manifest, side_info)
            manifest, side_info = columns_head(manifest, side_info, decoder.partial)
            self._columns = decoder, manifest
        return file_head(manifest, side_info)

    def _record(self, packet: Packet) -> bytes:
        if self._columns is not None:
            decoder, manifest = self._columns
            decoder.add([packet])
            ranks = decoder.members(packet)
            packet = columns_packet(packet, rows_of(decoder.partial.scene.anchors, ranks), manifest)
        return file_record(packet.data)
