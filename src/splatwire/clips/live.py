"""A clip that grows while it is watched: frames of each group as soon as they can be shown."""

import itertools
from collections.abc import Iterable, Iterator, Mapping
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
from splatwire.packets import Manifest, Packet


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
        self._method = clip_concealer(concealer)
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
        yield from self._complete()

    def add(self, packets: Iterable[Packet]) -> Iterator[ClipFrame]:
        """Takes packets that the manifest has a place for; frames of a group that is complete now.

        Raises:
            BitstreamError: If a scene of all tracks takes too much memory.
        """
        assert self._manifest is not None
        for packet in packets:
            self._num_bytes += packet.num_bytes
            block, plan = packet.id.block, self._manifest.plan
            group = plan.tier_of(block) // 2
            if group < self._next and not plan.lasting(block):
                continue
            self._blocks.setdefault(block, []).append(packet)
            self._fresh.add(block)
            self._have[group] = self._have.get(group, 0) + packet.num_elements
            if self._decoder is not None and not plan.lasting(block):
                self._opened().prepare(packet, self._num_bytes)
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
            frames, self._memory = decode_group(clip, group, clip.tracks.received, self._memory, self._method)
            for frame in frames:
                yield replace(frame, number=frame.number + self._first_frame)

    def _store(self, decoder: TracksDecoder, manifest: Manifest, group: int) -> None:
        """Writes bases that are new, and the motion of a group; forgets older motion."""
        plan, motion = manifest.plan, 2 * group + 1
        for block in [block for block in self._blocks if not plan.lasting(block) and plan.tier_of(block) < motion]:
            del self._blocks[block]
        wanted = {
            block for block in self._blocks
            if (block in self._fresh if plan.lasting(block) else plan.tier_of(block) == motion)
        }  # fmt: skip
        packets = itertools.chain.from_iterable(self._blocks[block] for block in sorted(wanted))
        for run in runs_of(decoder, manifest, packets):
            decoder.store(run, decoder.decode(run) if plan.lasting(run.block) else ())
        self._fresh -= {block for block in wanted if plan.lasting(block)}
        self._have = {number: count for number, count in self._have.items() if number > group}


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
