"""A clip that grows while it is watched: frames of each group as soon as they can be shown."""

import itertools
import queue
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace

from splatwire.byte_io import ByteReader
from splatwire.clips.concealers import DEFAULT, clip_concealer
from splatwire.clips.decoding import ClipFrame, decode_group
from splatwire.clips.encoding import FIRST_FRAME
from splatwire.clips.poses import Memory
from splatwire.codec.decoding import runs_of
from splatwire.codec.memory import allocating, check_memory
from splatwire.codec.schemas.tracks.decoder import TracksDecoder
from splatwire.errors import BitstreamError
from splatwire.ops.threads import allowed_threads
from splatwire.packets import Manifest, Packet
from splatwire.transport.events import Event, PacketArrived, SideInfoArrived


class LiveDecoder:
    """Decodes a clip that grows, group by group; holds the bases, and the motion of the running group.

    A group is shown as soon as all of it is there, or when the next one begins: motion that comes later is dropped,
    bases are taken whenever they come. Who joins late begins with the running group. Where another stream follows, the
    next chapter of an endless clip, what was before is forgotten, and frames are counted on.

    Args:
        concealer: What becomes of tracks whose motion was lost, or its name.

    Raises:
        UnknownNameError: If there is no such concealer.
    """

    def __init__(self, concealer: str = DEFAULT) -> None:
        self._method, self._threads = clip_concealer(concealer), allowed_threads()
        self._begin()

    def _begin(self) -> None:
        self._manifest: Manifest | None = None
        self._side_info = b""
        self._decoder: TracksDecoder | None = None
        self._blocks: dict[int, list[Packet]] = {}
        self._fresh: set[int] = set()
        self._have: dict[int, int] = {}
        self._next = self._first_frame = 0
        self._memory: Memory | None = None
        self._num_bytes = 0

    def grow(self, manifest: Manifest, side_info: bytes) -> Iterator[ClipFrame]:
        """Takes what is said of the clip by now; frames of groups whose time has passed, and what is complete.

        Raises:
            BitstreamError: If it contradicts what was said before, or is not of a clip.
        """
        if not manifest.schema.timed:
            raise BitstreamError(f"a stream of {manifest.elements} is a scene, not a clip")
        if self._manifest is not None and self._manifest.stream_id != manifest.stream_id:
            yield from self.finish()
            self._begin()
        if self._manifest is None:
            self._next = len(manifest.tiers) // 2 - 1
        elif manifest.tiers[: len(self._manifest.tiers)] != self._manifest.tiers:
            raise BitstreamError("a clip that grows says other things of what was there already")
        self._manifest, self._side_info = manifest, side_info
        yield from self._shown(len(manifest.tiers) // 2 - 1)
        if self._decoder is not None:  # while packets are on their way, of which some may lack for tracks to be so many
            with suppress(BitstreamError):
                self._opened()
        yield from self._complete()

    def add(self, packets: Iterable[Packet]) -> Iterator[ClipFrame]:
        """Takes packets that the manifest has a place for; frames of a group that is complete now.

        Raises:
            BitstreamError: If a scene of all tracks takes too much memory.
        """
        assert self._manifest is not None
        plan, motion = self._manifest.plan, list[Packet]()
        for packet in packets:
            self._num_bytes += packet.num_bytes
            block = packet.id.block
            group = plan.tier_of(block) // 2
            if group < self._next and not plan.lasting(block):
                continue
            self._blocks.setdefault(block, []).append(packet)
            self._have[group] = self._have.get(group, 0) + packet.num_elements
            if plan.lasting(block):
                self._fresh.add(block)
            else:
                motion.append(packet)
        if motion and self._decoder is not None:
            opened = self._opened()
            self._store_bases(opened, self._manifest, whole=True)
            for _, some in itertools.groupby(motion, lambda packet: plan.tier_of(packet.id.block)):
                opened.prepare(list(some), self._num_bytes, self._threads)
        yield from self._complete()

    def finish(self) -> Iterator[ClipFrame]:
        """Frames of what has come and was not shown: nothing more will come."""
        if self._manifest is not None:
            yield from self._shown(len(self._manifest.tiers) // 2)

    def _complete(self) -> Iterator[ClipFrame]:
        """Frames of the next group if all of it is there."""
        assert self._manifest is not None
        tiers = self._manifest.tiers[2 * self._next : 2 * self._next + 2]
        if tiers and self._have.get(self._next, 0) == sum(tier.num_elements for tier in tiers):
            yield from self._shown(self._next + 1)

    def _shown(self, end: int) -> Iterator[ClipFrame]:
        """Frames of the groups before `end` that were not shown."""
        while self._next < end:
            group, self._next = self._next, self._next + 1
            yield from self._group(group)

    def _opened(self) -> TracksDecoder:
        """The decoder of what is said of the clip by now; goes on from the one before.

        Raises:
            BitstreamError: If a scene of all tracks takes too much memory.
        """
        assert self._manifest is not None
        if self._decoder is not None and self._decoder.manifest is self._manifest:
            return self._decoder
        num_bytes, what = len(self._side_info) + self._num_bytes, f"decoding {self._manifest.num_elements:,} tracks"
        opened = TracksDecoder(self._manifest, self._side_info, num_bytes)
        check_memory(opened.scene_bytes, num_bytes, what)
        with allocating(what):
            opened.expect(None)
            if self._decoder is not None:
                opened.take_over(self._decoder)
        self._decoder, self._first_frame = opened, first_frame(opened.sections)
        return opened

    def _group(self, group: int) -> Iterator[ClipFrame]:
        assert self._manifest is not None
        opened = self._opened()
        with allocating(f"decoding {self._manifest.num_elements:,} tracks"):
            self._store(opened, self._manifest, group)
            clip = opened.scene().scene
            frames, after = decode_group(clip, group, clip.tracks.received, self._memory, self._method)
            for frame in frames:
                yield replace(frame, number=frame.number + self._first_frame)
            self._memory = after()

    def _store(self, decoder: TracksDecoder, manifest: Manifest, group: int) -> None:
        """Writes bases that are new, and the motion of a group; forgets older motion."""
        self._store_bases(decoder, manifest, whole=False)
        plan, motion = manifest.plan, 2 * group + 1
        for block in [block for block in self._blocks if not plan.lasting(block) and plan.tier_of(block) < motion]:
            del self._blocks[block]
        for block in [block for block in self._blocks if plan.tier_of(block) == motion]:
            decoder.hold(block, tuple(sorted(self._blocks[block], key=lambda packet: packet.id)))
        self._have = {number: count for number, count in self._have.items() if number > group}

    def _store_bases(self, decoder: TracksDecoder, manifest: Manifest, *, whole: bool) -> None:
        """Writes bases that are new; of whole blocks only, or of all."""
        there = {block: sum(packet.num_elements for packet in self._blocks[block]) for block in self._fresh}
        bases = {block for block, count in there.items() if not whole or count == manifest.plan.block_elements(block)}
        packets = itertools.chain.from_iterable(self._blocks[block] for block in sorted(bases))
        for run in runs_of(decoder, manifest, packets):
            decoder.store(run, decoder.decode(run))
        self._fresh -= bases


def frames_in_turn(decoder: LiveDecoder, waiting: "queue.SimpleQueue[Event | None]") -> Iterator[ClipFrame]:
    """Frames of what a receiver tells of, until it tells None; packets that wait together are decoded together.

    Raises:
        BitstreamError: See `LiveDecoder`.
    """
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
            yield from decoder.grow(event.manifest, event.side_info)
    if packets:
        yield from decoder.add(packets)
    yield from decoder.finish()


def first_frame(sections: Mapping[str, bytes]) -> int:
    """Number of a clip's first frame: not 0 where it goes on with another clip.

    Raises:
        BitstreamError: If it is damaged.
    """
    if FIRST_FRAME not in sections:
        return 0
    reader = ByteReader(sections[FIRST_FRAME], f"section '{FIRST_FRAME}'")
    number = reader.unsigned()
    reader.finish()
    return number
