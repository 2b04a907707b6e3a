"""Receiver of a stream from a relay of Media over QUIC (MoQ): subscribes to tracks in order of importance."""

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from splatwire.bitstream import Manifest, PacketIntake, ReadReport, SceneStream, packet_from_bytes
from splatwire.bitstream.container import check_side_info
from splatwire.bitstream.limits import MAX_PACKET_BYTES
from splatwire.bitstream.origin import ORIGIN_SECTION
from splatwire.bitstream.scene_stream import RECORD_PREFIX
from splatwire.bitstream.tile_selection import cut_of
from splatwire.bitstream.tiles import Tiles
from splatwire.errors import BitstreamError, InvalidValueError
from splatwire.transport.address import Address
from splatwire.transport.moq.publisher import (
    CONNECT_TIMEOUT_S,
    INIT_TRACK,
    INIT_TRACK_PRIORITY,
    MAX_CACHE_AGE_US,
    RelayTrust,
    error_text,
    need_moq,
    packets_of_tracks,
    session,
    tiles_of,
)
from splatwire.transport.protocol.events import (
    Event,
    Finished,
    Interrupted,
    PacketArrived,
    Resumed,
    SideInfoArrived,
    Welcomed,
)
from splatwire.transport.protocol.layout import split_init_segment
from splatwire.transport.protocol.receiver_options import ReceiverOptions

MAX_SUBSCRIPTIONS = 8
"""Maximum number of concurrent track subscriptions."""
RECONNECT_INTERVAL_S = 1.0
"""Pause between two sessions with the relay, after an outage, seconds."""


class InterruptedTransferError(BitstreamError):
    """The session with the relay has ended early. A new session may resume the transfer."""


def _records(data: bytes) -> Iterator[bytes]:
    """Splits bytes into records, each preceded by its size, and yields them. An incomplete last record is skipped."""
    at = 0
    while at + RECORD_PREFIX.size <= len(data):
        (size,) = RECORD_PREFIX.unpack_from(data, at)
        at += RECORD_PREFIX.size + size
        if at <= len(data):
            yield data[at - size : at]


@dataclass(frozen=True)
class _NoRepairs:
    """Numbers of damaged and repaired packets, so that reports have the same form for all receivers.

    Both are always 0: over a relay, packets are sent on reliable QUIC streams without repair symbols.

    Attributes:
        num_bad: Number of damaged packets.
        num_repaired: Number of lost packets that were recovered from repair symbols.
    """

    num_bad: int = 0
    num_repaired: int = 0


class RelayReceiver:
    """Receiver of a stream from a relay; has the same attributes for results as `Receiver`.

    Args:
        options: Options of the receiver.
        on_event: Called with every event, such as an arrived packet.
    """

    preview = b""
    was_live, num_missed = False, 0

    def __init__(self, options: ReceiverOptions, on_event: Callable[[Event], Any] | None) -> None:
        self.options = options
        self.finished: Finished | None = None
        self.num_bytes = self.num_datagrams = self.num_rejected = 0
        self.collector = _NoRepairs()
        self._on_event = on_event or (lambda event: None)
        self._intake: PacketIntake | None = None
        self._manifest: Manifest | None = None
        self._side_info = self._init_bytes = b""
        self._subscriptions: list[Any] = []
        self._complete_tracks: set[int] = set()
        self._heard_at, self._bytes_before, self._is_interrupted = 0.0, 0, False

    def stream(self) -> SceneStream | None:
        """Returns the stream with the packets received so far, or None until the side information is complete."""
        if self._manifest is None or self._intake is None:
            return None
        return SceneStream(self._manifest, self._side_info, self._intake.packets)

    def report(self) -> ReadReport | None:
        """Returns the numbers of received and missing packets; None until the side information is complete."""
        return self._intake.report() if self._intake else None

    def describe_missing(self) -> str:
        """Returns a message about the data that the relay has not delivered."""
        return "" if self._manifest else "the relay gave no side information"

    def finish(self, reason: str) -> None:
        """Ends the transfer and reports the reason as an event."""
        if self.finished is None:
            self.finished = Finished(reason, self._manifest is not None)
            self._on_event(self.finished)

    def interrupt(self, now: float) -> bool:
        """Records an interruption, and returns True if the transfer may still be resumed.

        If so, also reports the interruption as an event. Repeated calls report nothing until the transfer has
        continued.

        Args:
            now: Time, seconds.
        """
        if self._manifest is None or now - self._heard_at > self.options.reconnect_s or not self.options.reconnect_s:
            return False
        if not self._is_interrupted:
            self._is_interrupted = True
            self._on_event(Interrupted())
        return True

    async def receive(self, broadcast: Any) -> str:
        """Receives manifest and side information, then packets in order of importance.

        After an interruption, call this again with the broadcast of a new session; received data are kept.

        Args:
            broadcast: Broadcast of the scene in the session with the relay (package `moq`).

        Returns:
            Reason of the end of the transfer, as in `Finished.reason`.

        Raises:
            InterruptedTransferError: If the relay is silent or ends a track early.
            BitstreamError: If the init segment is invalid.
        """
        self._subscriptions.clear()
        self._bytes_before = self.num_bytes
        max_bytes = self.options.limits.init_segment_bytes
        frames = self._frames(broadcast, INIT_TRACK, INIT_TRACK_PRIORITY, max_bytes, max_bytes // 64 + 1)
        data = b"".join([frame async for frame in frames])
        manifest, self._side_info, bundled = split_init_segment(data)
        check_side_info(manifest, self._side_info, "the side information that was sent")
        if bundled or manifest.num_packets > self.options.limits.packets:
            raise BitstreamError(f"the relay announces {manifest.num_packets} packets")
        tiles = tiles_of(manifest, self._side_info)
        is_same = data == self._init_bytes
        if self._is_interrupted:
            self._is_interrupted = False
            self._on_event(Resumed(is_same))
        if not is_same or self._intake is None:
            self._init_bytes, self._manifest, self._intake = data, manifest, PacketIntake(manifest)
            self._complete_tracks = set()
            self._on_event(Welcomed(manifest.num_packets, len(data)))
            self._on_event(SideInfoArrived(manifest, self._side_info, self._intake))
        track_packets, order = packets_of_tracks(manifest, tiles), self._order(manifest, tiles)
        complete = self._complete_tracks
        wanted = [
            (rank, number) for rank, number in enumerate(order) if track_packets[number] and number not in complete
        ]
        waiting = iter([(number, track_packets[number], rank) for rank, number in wanted])

        async def work() -> None:
            for number, indices, rank in waiting:
                await self._receive_track(
                    broadcast,
                    number,
                    indices,
                    max(1, INIT_TRACK_PRIORITY - 1 - rank * INIT_TRACK_PRIORITY // len(order)),
                )

        tasks = [asyncio.ensure_future(work()) for _ in range(MAX_SUBSCRIPTIONS)]
        try:
            await asyncio.gather(*tasks)
        finally:
            for task in tasks:
                task.cancel()
        if self._intake.report().complete:
            return "complete"
        seen = self.options.viewpoint is not None and all(number in self._complete_tracks for _, number in wanted)
        return "seen" if seen else "sent"

    def _order(self, manifest: Manifest, tiles: Tiles | None) -> list[int]:
        """Returns the indices of the MoQ tracks to receive, most important first.

        The track `part/N` has the index N. With a viewpoint, only the tracks of visible tiles are received.

        Args:
            manifest: Manifest of the stream.
            tiles: Tiles of the stream, one for each track; None for a stream without levels of detail.
        """
        if tiles is None or self.options.viewpoint is None:
            return list(range(len(packets_of_tracks(manifest, tiles))))
        viewpoint = self.options.viewpoint.relative_to(
            ORIGIN_SECTION.of_side_info(self._side_info, manifest.schema_name)
        )
        return list(cut_of(tiles, np.zeros(tiles.num_tiles, dtype=bool), viewpoint).wanted)

    async def _receive_track(self, broadcast: Any, number: int, indices: range, priority: int) -> None:
        assert self._manifest is not None
        assert self._intake is not None
        max_bytes = min(len(indices) * (RECORD_PREFIX.size + MAX_PACKET_BYTES), self.options.limits.stream_bytes)
        frames = self._frames(broadcast, f"part/{number}", priority, max_bytes, len(indices))
        data = b"".join([frame async for frame in frames])
        num_accepted = 0
        for record in _records(data):
            try:
                packet = self._intake.add(packet_from_bytes(record, self._manifest.stream_id), "relay")
            except BitstreamError:
                packet = None
            if packet is None:
                self.num_rejected += 1
            else:
                num_accepted += 1
                self._on_event(PacketArrived(packet, False))
        if num_accepted == len(indices):
            self._complete_tracks.add(number)

    async def _frames(
        self, broadcast: Any, name: str, priority: int, max_bytes: int, max_frames: int
    ) -> AsyncIterator[bytes]:
        """Subscribes to a track of the relay and yields its data frame by frame.

        Args:
            broadcast: The scene at the relay (package `moq`).
            name: Name of the track.
            priority: Priority of the subscription; the relay sends tracks with higher priority first.
            max_bytes: Maximum total size of the frames, bytes.
            max_frames: Maximum number of frames.

        Raises:
            InterruptedTransferError: If the relay is silent or ends the track early.
            BitstreamError: If the frames exceed the limits on number or size.
        """
        moq = need_moq()
        wanted = moq.Subscription(priority=priority, max_age_us=MAX_CACHE_AGE_US)
        try:
            async with asyncio.timeout(self.options.silence_s):
                track = await broadcast.subscribe_track(name, wanted)
                self._subscriptions.append(track)  # a relay drops tracks without subscribers
                group = await track.recv_group()
            while group is not None:
                async with asyncio.timeout(self.options.silence_s):
                    frame = await group.read_frame()
                if frame is None:
                    return
                self._heard_at = asyncio.get_running_loop().time()
                max_bytes, max_frames = max_bytes - len(frame.payload), max_frames - 1
                self.num_bytes += len(frame.payload)
                self.num_datagrams += 1
                num_bytes = self.num_bytes - self._bytes_before
                if max_bytes < 0 or max_frames < 0 or num_bytes > self.options.limits.stream_bytes:
                    raise BitstreamError(f"the track '{name}' of the relay is larger than it can be")
                yield frame.payload
        except TimeoutError as error:
            raise InterruptedTransferError(f"the relay fell silent before the end of the track '{name}'") from error
        except moq.Error as error:
            raise InterruptedTransferError(
                f"the relay gave up the track '{name}': {error_text(error) or 'it ended'}"
            ) from error


async def receive_relayed(
    address: Address, options: ReceiverOptions, trust: RelayTrust, on_event: Callable[[Event], Any] | None = None,
    stop: asyncio.Future[None] | None = None,
) -> RelayReceiver:  # fmt: skip
    """Receives a stream from a relay of Media over QUIC.

    Args:
        address: Address of the relay, and the scene's name.
        options: Options of the receiver.
        trust: Accepted certificates of the relay.
        on_event: Called with every event, such as an arrived packet.
        stop: Future whose completion ends the transfer; received data are kept.

    Raises:
        InvalidValueError: If no session can be opened.
    """
    receiver = RelayReceiver(options, on_event)

    async def attempt() -> str:
        async with session(address, trust) as (client, name):
            try:
                async with asyncio.timeout(CONNECT_TIMEOUT_S):
                    broadcast = await client.announced_broadcast(name).available()
            except TimeoutError as error:
                raise InterruptedTransferError(f"the relay has no broadcast '{name}'") from error
            return await receiver.receive(broadcast)

    async def work() -> str:
        while True:
            try:
                return await attempt()
            except (InterruptedTransferError, InvalidValueError, need_moq().Error) as error:
                if not receiver.interrupt(asyncio.get_running_loop().time()):
                    if isinstance(error, InvalidValueError) and receiver.stream() is None:
                        raise
                    return error_text(error) or "the relay ended the session"
            await asyncio.sleep(RECONNECT_INTERVAL_S)

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
