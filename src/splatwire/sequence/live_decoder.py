"""Decoder of live sequences: yields the frames of a group of pictures (GOP) without waiting for later groups."""

import itertools
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace

from splatwire.bitstream import Manifest, Packet
from splatwire.codec.decoding import batches_of
from splatwire.codec.memory import allocating, check_memory
from splatwire.codec.sequence.decoder import TracksDecoder
from splatwire.concealment.temporal.concealers import DEFAULT, temporal_concealer
from splatwire.concealment.temporal.poses import ConcealmentState
from splatwire.errors import BitstreamError
from splatwire.files.byte_io import ByteReader
from splatwire.ops.threads import allowed_threads
from splatwire.sequence.decoding import SequenceFrame, decode_group
from splatwire.sequence.encoding import FIRST_FRAME
from splatwire.sequence.waiting_events import WaitingEvents
from splatwire.transport.protocol.events import PacketArrived, SideInfoArrived


class LiveDecoder:
    """Decoder of a live sequence that outputs the frames of one group of pictures at a time.

    A group is output when it is complete, or when the next group begins. A receiver that joins late starts with the
    current group, or with the first group after it of which it has Gaussians to show.

    Args:
        concealer: Name of the concealer for tracks with lost motion.

    Raises:
        UnknownNameError: If the concealer is unknown.
    """

    def __init__(self, concealer: str = DEFAULT) -> None:
        self._method, self._threads = temporal_concealer(concealer), allowed_threads()
        self._begin()

    def _begin(self) -> None:
        self._manifest: Manifest | None = None
        self._side_info = b""
        self._decoder: TracksDecoder | None = None
        self._packets_by_block: dict[int, list[Packet]] = {}
        self._new_keyframe_blocks: set[int] = set()
        self._has_keyframes = False
        self._num_received: dict[int, int] = {}
        self._next_group = self._first_frame = 0
        self._concealment_state: ConcealmentState | None = None
        self._num_bytes = 0

    def update_header(self, manifest: Manifest, side_info: bytes) -> Iterator[SequenceFrame]:
        """Updates manifest and side information when the server adds a group of pictures; yields newly complete frames.

        Raises:
            BitstreamError: If the manifest contradicts the previous manifest, or does not belong to a sequence.
        """
        if not manifest.schema.timed:
            raise BitstreamError(f"a stream of {manifest.elements} is a scene, not a clip")
        if self._manifest is not None and self._manifest.stream_id != manifest.stream_id:
            yield from self.finish()
            self._begin()
        if self._manifest is None:
            self._next_group = len(manifest.tiers) // 2 - 1
        elif manifest.tiers[: len(self._manifest.tiers)] != self._manifest.tiers:
            raise BitstreamError("a further manifest of the live clip contradicts the previous one")
        self._manifest, self._side_info = manifest, side_info
        yield from self._frames_before(len(manifest.tiers) // 2 - 1)
        if self._decoder is not None:  # optional while packets are missing: many declared tracks may be unjustified yet
            with suppress(BitstreamError):
                self._current_decoder()
        yield from self._complete_group()

    def add(self, packets: Iterable[Packet]) -> Iterator[SequenceFrame]:
        """Adds packets; yields the frames of a group of pictures that is now complete.

        Raises:
            BitstreamError: If the tracks declared in the manifest need more memory than the received bytes justify.
        """
        assert self._manifest is not None
        plan, motion = self._manifest.plan, list[Packet]()
        for packet in packets:
            self._num_bytes += packet.num_bytes
            block = packet.id.block
            group = plan.gop_of_block(block)
            if group < self._next_group and not plan.is_keyframe(block):
                continue
            self._packets_by_block.setdefault(block, []).append(packet)
            self._num_received[group] = self._num_received.get(group, 0) + packet.num_elements
            if plan.is_keyframe(block):
                self._new_keyframe_blocks.add(block)
                self._has_keyframes = True
            else:
                motion.append(packet)
        if motion and self._decoder is not None:
            decoder = self._current_decoder()
            self._store_keyframes(decoder, self._manifest, complete_only=True)
            for _, packets_of_tier in itertools.groupby(motion, lambda packet: plan.tier_of(packet.id.block)):
                decoder.predecode(list(packets_of_tier), self._num_bytes, self._threads)
        yield from self._complete_group()

    def finish(self) -> Iterator[SequenceFrame]:
        """Ends the stream; yields the frames that were not output yet."""
        if self._manifest is not None:
            yield from self._frames_before(len(self._manifest.tiers) // 2)

    def _complete_group(self) -> Iterator[SequenceFrame]:
        """Yields the frames of the next group of pictures, if all its packets have arrived."""
        assert self._manifest is not None
        tiers = self._manifest.tiers[2 * self._next_group : 2 * self._next_group + 2]
        if tiers and self._num_received.get(self._next_group, 0) == sum(tier.num_elements for tier in tiers):
            yield from self._frames_before(self._next_group + 1)

    def _frames_before(self, end: int) -> Iterator[SequenceFrame]:
        """Yields the frames of all groups of pictures with an index below `end` that were not yet output."""
        while self._next_group < end:
            group, self._next_group = self._next_group, self._next_group + 1
            yield from self._frames_of(group)

    def _current_decoder(self) -> TracksDecoder:
        """Returns the decoder for the current manifest of the stream."""
        assert self._manifest is not None
        if self._decoder is not None and self._decoder.manifest is self._manifest:
            return self._decoder
        num_bytes, activity = len(self._side_info) + self._num_bytes, f"decoding {self._manifest.num_elements:,} tracks"
        decoder = TracksDecoder(self._manifest, self._side_info, num_bytes)
        check_memory(decoder.scene_bytes, num_bytes, activity)
        with allocating(activity):
            decoder.allocate(None)
            if self._decoder is not None:
                # The keyframe Gaussians are not decoded again.
                decoder.copy_keyframes_from(self._decoder)
        self._decoder, self._first_frame = decoder, first_frame(decoder.sections)
        return decoder

    def _frames_of(self, group: int) -> Iterator[SequenceFrame]:
        assert self._manifest is not None
        decoder = self._current_decoder()
        with allocating(f"decoding {self._manifest.num_elements:,} tracks"):
            self._store(decoder, self._manifest, group)
            if not self._has_keyframes:  # nothing has arrived yet: the frames are unknown, not empty
                return
            sequence = decoder.scene().scene
            frames, state_after = decode_group(
                sequence, group, sequence.tracks.received, self._concealment_state, self._method
            )
            for frame in frames:
                yield replace(frame, number=frame.number + self._first_frame)
            self._concealment_state = state_after()

    def _store(self, decoder: TracksDecoder, manifest: Manifest, group: int) -> None:
        """Passes the received keyframe packets and motion packets of a group of pictures to a decoder.

        Args:
            decoder: Decoder that stores the data.
            manifest: Current manifest.
            group: Index of the group of pictures.
        """
        self._store_keyframes(decoder, manifest, complete_only=False)
        plan = manifest.plan
        motion_blocks = [block for block in self._packets_by_block if not plan.is_keyframe(block)]
        for block in motion_blocks:
            if plan.gop_of_block(block) < group:
                del self._packets_by_block[block]
        for block in motion_blocks:
            if plan.gop_of_block(block) != group:
                continue
            decoder.store_motion(block, tuple(sorted(self._packets_by_block[block], key=lambda packet: packet.id)))
        self._num_received = {number: count for number, count in self._num_received.items() if number > group}

    def _store_keyframes(self, decoder: TracksDecoder, manifest: Manifest, *, complete_only: bool) -> None:
        """Decodes the keyframe packets that were received since the last call, and stores their Gaussians.

        Args:
            decoder: Decoder that stores the Gaussians.
            manifest: Current manifest.
            complete_only: True to decode only blocks whose packets have all arrived. False to also decode blocks with
                missing packets. A block is a group of keyframe Gaussians that are coded together.
        """
        num_received = {
            block: sum(packet.num_elements for packet in self._packets_by_block[block])
            for block in self._new_keyframe_blocks
        }
        keyframes = {
            block
            for block, count in num_received.items()
            if not complete_only or count == manifest.plan.block_elements(block)
        }
        packets = itertools.chain.from_iterable(self._packets_by_block[block] for block in sorted(keyframes))
        for batch in batches_of(decoder, manifest, packets):
            decoder.store(batch, decoder.decode(batch))
        self._new_keyframe_blocks -= keyframes


def frames_of_events(decoder: LiveDecoder, waiting: WaitingEvents) -> Iterator[SequenceFrame]:
    """Decodes a live sequence from the events of its receiver, and yields each frame as soon as possible.

    Args:
        decoder: Decoder of the sequence.
        waiting: Queue of the events.

    Raises:
        BitstreamError: If the stream is invalid or needs too much memory.
    """
    # Packets that are queued at the same time are decoded together.
    packets = list[Packet]()
    for event in iter(waiting.get, None):
        if isinstance(event, PacketArrived):
            packets.append(event.packet)
            if not waiting.empty():
                continue
        if packets:
            yield from decoder.add(packets)
            packets = []
        if isinstance(event, SideInfoArrived):
            yield from decoder.update_header(event.manifest, event.side_info)
    if packets:
        yield from decoder.add(packets)
    yield from decoder.finish()


def first_frame(sections: Mapping[str, bytes]) -> int:
    """Returns the number of a sequence's first frame, above 0 in a sequence that continues an earlier one.

    Args:
        sections: Named sections of the side information.

    Raises:
        BitstreamError: If the section with the number is damaged.
    """
    if FIRST_FRAME not in sections:
        return 0
    reader = ByteReader(sections[FIRST_FRAME], f"section '{FIRST_FRAME}'")
    number = reader.unsigned()
    reader.finish()
    return number
