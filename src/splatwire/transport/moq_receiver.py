"""Receiving from a relay of Media over QUIC: tracks in the order in which they are wanted."""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from splatwire.errors import BitstreamError
from splatwire.packets import Manifest, PacketIntake, ReadReport, SceneStream, packet_from_bytes
from splatwire.packets.container import check_side_info
from splatwire.packets.limits import MAX_PACKET_BYTES
from splatwire.packets.scene_stream import RECORD_PREFIX
from splatwire.packets.tiles import Tiles
from splatwire.packets.view import cut_of
from splatwire.transport.address import Address
from splatwire.transport.events import Event, Finished, PacketArrived, SideInfoArrived, Welcomed
from splatwire.transport.layout import split_head_object
from splatwire.transport.moq import (
    CONNECT_S,
    FOREMOST,
    HEAD,
    KEPT_US,
    RelayTrust,
    need_moq,
    parts_of,
    session,
    tiles_of,
)
from splatwire.transport.receiver_options import ReceiverOptions

AT_ONCE = 8
"""Tracks that are on their way to one receiver."""


def _records(data: bytes) -> Iterator[bytes]:
    """What stands behind its size, one after another; what is cut is left out."""
    at = 0
    while at + RECORD_PREFIX.size <= len(data):
        (size,) = RECORD_PREFIX.unpack_from(data, at)
        at += RECORD_PREFIX.size + size
        if at <= len(data):
            yield data[at - size : at]


@dataclass(frozen=True)
class _Counts:
    """What verbs tell of packets beyond the report; nothing is repaired here, all comes whole."""

    num_bad: int = 0
    num_repaired: int = 0


class RelayReceiver:
    """What came from a relay, as `Receiver` has it.

    Args:
        options: What is wanted.
        on_event: Called for every event.
    """

    preview = b""

    def __init__(self, options: ReceiverOptions, on_event: Callable[[Event], Any] | None) -> None:
        self.options = options
        self.finished: Finished | None = None
        self.num_bytes = self.num_datagrams = self.num_rejected = 0
        self.collector = _Counts()
        self._tell = on_event or (lambda event: None)
        self._intake: PacketIntake | None = None
        self._manifest: Manifest | None = None
        self._side_info = b""
        self._held: list[Any] = []

    def stream(self) -> SceneStream | None:
        """What is there by now; None as long as side information is missing."""
        if self._manifest is None or self._intake is None:
            return None
        return SceneStream(self._manifest, self._side_info, self._intake.packets)

    def report(self) -> ReadReport | None:
        """Counts of the packets; None as long as side information is missing."""
        return self._intake.report() if self._intake else None

    def lacking(self) -> str:
        """What is missing, in words."""
        return "" if self._manifest else "the relay gave no side information"

    def finish(self, reason: str) -> None:
        """Ends it."""
        if self.finished is None:
            self.finished = Finished(reason, self._manifest is not None)
            self._tell(self.finished)

    async def receive(self, broadcast: Any) -> str:
        """Receives the head, then parts in the order in which they are wanted; gives the words for how it ended.

        Raises:
            BitstreamError: If the head is none.
        """
        most = self.options.limits.head_bytes
        data = b"".join([frame async for frame in self._frames(broadcast, HEAD, FOREMOST, most, most // 64 + 1)])
        manifest, self._side_info, carried = split_head_object(data)
        check_side_info(manifest, self._side_info, "the side information that was sent")
        if carried or manifest.num_packets > self.options.limits.packets:
            raise BitstreamError(f"the relay announces {manifest.num_packets} packets")
        tiles = tiles_of(manifest, self._side_info)
        self._manifest, self._intake = manifest, PacketIntake(manifest)
        self._tell(Welcomed(manifest.num_packets, len(data)))
        self._tell(SideInfoArrived(manifest, self._side_info, self._intake))
        parts, order = parts_of(manifest, tiles), self._order(manifest, tiles)
        waiting = iter([(number, parts[number], rank) for rank, number in enumerate(order) if parts[number]])

        async def work() -> None:
            for number, places, rank in waiting:
                await self._part(broadcast, number, places, max(1, FOREMOST - 1 - rank * FOREMOST // len(order)))

        tasks = [asyncio.ensure_future(work()) for _ in range(AT_ONCE)]
        try:
            await asyncio.gather(*tasks)
        finally:
            for task in tasks:
                task.cancel()
        if self._intake.report().complete:
            return "complete"
        return "sent" if self.options.look is None else "seen"

    def _order(self, manifest: Manifest, tiles: Tiles | None) -> list[int]:
        """Parts in the order in which they are wanted."""
        if tiles is None or self.options.look is None:
            return list(range(len(parts_of(manifest, tiles))))
        return list(cut_of(tiles, np.zeros(tiles.num_tiles, dtype=bool), self.options.look).wanted)

    async def _part(self, broadcast: Any, number: int, places: range, priority: int) -> None:
        assert self._manifest is not None
        assert self._intake is not None
        most = min(len(places) * (RECORD_PREFIX.size + MAX_PACKET_BYTES), self.options.limits.stream_bytes)
        data = b"".join(
            [frame async for frame in self._frames(broadcast, f"part/{number}", priority, most, len(places))]
        )
        for record in _records(data):
            try:
                packet = self._intake.take(packet_from_bytes(record, self._manifest.stream_id), "relay")
            except BitstreamError:
                packet = None
            if packet is None:
                self.num_rejected += 1
            else:
                self._tell(PacketArrived(packet, False))

    async def _frames(
        self, broadcast: Any, name: str, priority: int, most_bytes: int, most_frames: int
    ) -> AsyncIterator[bytes]:
        """Frames of the one group of a track.

        Raises:
            BitstreamError: If they are more or larger than they can be, or it says nothing for long.
        """
        moq = need_moq()
        wanted = moq.Subscription(priority=priority, max_age_us=KEPT_US)
        try:
            async with asyncio.timeout(self.options.silence_s):
                track = await broadcast.subscribe_track(name, wanted)
                self._held.append(track)  # what nobody holds, a relay forgets
                group = await track.recv_group()
            while group is not None:
                async with asyncio.timeout(self.options.silence_s):
                    frame = await group.read_frame()
                if frame is None:
                    return
                most_bytes, most_frames = most_bytes - len(frame.payload), most_frames - 1
                self.num_bytes += len(frame.payload)
                self.num_datagrams += 1
                if most_bytes < 0 or most_frames < 0 or self.num_bytes > self.options.limits.stream_bytes:
                    raise BitstreamError(f"the track '{name}' of the relay is larger than it can be")
                yield frame.payload
        except TimeoutError as error:
            raise BitstreamError(f"the relay fell silent before the end of the track '{name}'") from error
        except moq.Error as error:
            raise BitstreamError(f"the relay gave up the track '{name}': {error}") from error


async def receive_relayed(
    address: Address, options: ReceiverOptions, trust: RelayTrust, on_event: Callable[[Event], Any] | None = None,
    stop: asyncio.Future[None] | None = None,
) -> RelayReceiver:  # fmt: skip
    """Receives a stream from a relay.

    Args:
        address: The relay, and the name of the scene there.
        options: What is wanted.
        trust: Which certificates are believed.
        on_event: Called for every event.
        stop: Ends the transfer when it is done; what arrived by then stays.

    Raises:
        InvalidValueError: If no session comes about.
    """
    receiver = RelayReceiver(options, on_event)

    async def work() -> str:
        async with session(address, trust) as (client, name):
            try:
                async with asyncio.timeout(CONNECT_S):
                    broadcast = await client.announced_broadcast(name).available()
            except TimeoutError:
                return f"nobody publishes '{name}' there"
            return await receiver.receive(broadcast)

    task = asyncio.ensure_future(work())
    if stop is not None:
        stop.add_done_callback(lambda _: task.cancel())
    try:
        async with asyncio.timeout(options.deadline_s):
            receiver.finish(await task)
    except TimeoutError:
        receiver.finish("deadline")
    except asyncio.CancelledError:
        if stop is None or not stop.done():
            raise
        receiver.finish("stopped")
    except BitstreamError as error:
        receiver.finish(str(error))
    return receiver
