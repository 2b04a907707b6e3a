"""Stream to clip: takes bytes and nothing else."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from splatwire.codec.antialiasing import SECTION as ANTIALIASED
from splatwire.codec.background import read_background
from splatwire.codec.memory import check_memory
from splatwire.codec.named_sections import concealer_sections
from splatwire.codec.origin import read_origin
from splatwire.codec.schema import Rows, Run
from splatwire.codec.schemas.gaussians.attributes import empty_rows as empty_bases
from splatwire.codec.schemas.gaussians.attributes import update_digest as digest_bases
from splatwire.codec.schemas.gaussians.decoder import blank_splats, decode_packets, store_block
from splatwire.codec.schemas.gaussians.layout import COLUMNS
from splatwire.codec.schemas.tracks.bases import placed
from splatwire.codec.schemas.tracks.layout import (
    AFTER,
    BEFORE,
    BEGINS,
    ENDS,
    HEAD,
    MOVING,
    NUM_CHANNELS,
    STATE,
    TRACK,
)
from splatwire.codec.schemas.tracks.motion_rows import coefficients_of, decode_motion
from splatwire.codec.schemas.tracks.motion_rows import update_digest as digest_motion
from splatwire.codec.schemas.tracks.side_info import ClipInfo, open_side_info
from splatwire.codec.schemas.tracks.steps import motion_shifts
from splatwire.codec.schemas.tracks.trajectories import Offsets, PacketMoves
from splatwire.codec.threads import ordered_map
from splatwire.model import Partial
from splatwire.model.clip import ClipScene, GroupMotion, Tracks
from splatwire.packets import Manifest, Packet, PacketId
from splatwire.scene import Erasures

SHOWN_BYTES = 768
"""Of memory, what a track takes while a group is concealed and its frames are made, beside its base and its motion."""

TOGETHER = 8
"""Packets of motion that are decoded together while they come."""

_Moved = tuple[np.ndarray, PacketMoves]
"""Of a packet of motion: heads int64 (n, HEAD), and what those do that move."""


class TracksDecoder:
    """See `splatwire.codec.schema.Decoder`; a run is what arrived of a block, of bases or of a group's motion.

    Args:
        manifest: The stream's manifest.
        side_info: Its side information.
        num_bytes: Bytes of the stream that are there.

    Raises:
        MissingSideInfoError: If there is no side information.
        BitstreamError: If it is damaged or contradicts the manifest.
    """

    order: np.ndarray | None = None
    whole_blocks, alone, again = True, True, True

    def __init__(self, manifest: Manifest, side_info: bytes, num_bytes: int) -> None:
        info, self.manifest = open_side_info(manifest, side_info), manifest
        self.info, self._plan, self._num = info, manifest.plan, manifest.num_elements
        self.sections = info.sections
        self._spans = _Spans(info, manifest)
        self._num_tracks = sum(group.births for group in info.groups)
        self._num_bytes, side = num_bytes, 3 * (info.bases.degree + 1) ** 2
        self.scene_bytes = self._num_tracks * (4 * (12 + side) + 8 * int(COLUMNS) + 24 + SHOWN_BYTES) + self._num
        frames = info.timeline.group_frames
        self.row_bytes = max(8 * int(COLUMNS) + 4 * info.bases.num_harmonics, 8 * HEAD + 4 * NUM_CHANNELS * frames)

    def working_bytes(self, packets: Sequence[Packet]) -> int:
        """See `Decoder.working_bytes`: rows of a few blocks, whose results wait for others."""
        largest = max((span.block_size for span in self._plan.spans if span.num_elements), default=0)
        return largest * (4 * self.row_bytes + 64) + (4 << 20)

    def expect(self, threads: int | None, progress: Callable[[float], None] | None = None) -> None:
        """See `Decoder.expect`."""
        self._lives = self.info.lifetimes.by_track(self._num_tracks, self.info.timeline.num_frames)
        self._splats = blank_splats(self._num_tracks, self.info.bases.degree)
        self._rows = np.zeros((self._num_tracks, int(COLUMNS)), np.int64)
        self._rounding = np.zeros(self._num_tracks, np.float32)
        self._received = np.zeros(self._num_tracks, dtype=np.bool_)
        self._erasures = Erasures.of_anchors(np.zeros(self._num, dtype=np.bool_))
        self._packets: dict[int, tuple[Packet, ...]] = {}
        self._sizes: dict[int, int] = {}
        self._ready: dict[PacketId, _Moved] = {}
        self._held = self.scene_bytes

    def take_over(self, other: "TracksDecoder") -> None:
        """Goes on from what a decoder of the same stream had when it was shorter; call `expect` first."""
        known = other._num_tracks
        for name in ("means", "quats", "scales", "opacities", "sh"):
            getattr(self._splats, name)[:known] = getattr(other._splats, name)
        self._rows[:known], self._received[:known] = other._rows, other._received
        self._rounding[:known] = other._rounding
        self._erasures.received[: other._num] = other._erasures.received

    def decode(self, run: Run) -> Rows:
        """See `Decoder.decode`."""
        group, base = self._spans.of(run.block)
        if base is not None:
            return decode_packets(self.info.bases, base, run.counts, run.payloads)
        return decode_motion(self.info, group, run.counts, run.payloads, self._spans.first_new[group])[:2]

    def store(self, run: Run, rows: Rows) -> None:
        """See `Decoder.store`: of motion the packets are kept, which are a hundredth of what is in them."""
        _, base = self._spans.of(run.block)
        self._erasures.received[run.ranks] = True
        if base is None:
            self.hold(run.block, run.packets)
            return
        self._sizes[run.block] = sum(packet.num_bytes for packet in run.packets)
        first, count = self._spans.tracks_of(base)
        received = np.zeros(count, dtype=bool)
        whole, harmonics = empty_bases(count, self.info.bases.num_harmonics)
        begin = 0
        for packet in run.packets:
            own, end = slice(packet.id.lane, packet.id.lane + packet.num_elements), begin + packet.num_elements
            received[own], whole[own], harmonics[own] = True, rows[0][begin:end], rows[1][begin:end]
            begin = end
        here = np.arange(first, first + count)
        store_block(self._splats, here, whole, harmonics, received, self.info.bases, base)
        self._rows[here] = placed(whole, self.info.bases, base)
        self._received[here] = received
        steps = motion_shifts(self._rows[here], self.info.bases, self.info.coarser)[:, 0]
        exponents = steps + self.info.bases.size_log - self.info.bases.unit - 1
        self._rounding[here] = np.ldexp(received.astype(np.float32), exponents)

    def hold(self, block: int, packets: tuple[Packet, ...]) -> None:
        """Keeps what arrived of a block of motion, in order, for whoever asks for its frames and not what is there."""
        self._packets[block] = packets
        self._sizes[block] = sum(packet.num_bytes for packet in packets)

    def update_digest(self, digest: Any, rows: Rows) -> None:
        """See `Decoder.update_digest`."""
        update_digest(digest, rows)

    def scene(self) -> Partial[ClipScene]:
        """See `Decoder.scene`."""
        blocks = self._spans.blocks_of_tracks()
        tracks = Tracks(self._splats, self._spans.born, self._received, blocks, self._rounding, *self._lives)
        background, antialiased = read_background(self.sections), ANTIALIASED in self.sections
        clip = ClipScene(
            self.info.timeline, tracks, self._motion, self._num, background, antialiased,
            origin=read_origin(self.sections),
        )  # fmt: skip
        return Partial(clip, self._erasures, concealer_sections(self.sections))

    def _motion(self, group: int, there: np.ndarray) -> GroupMotion:
        """What arrived of a group's motion, of tracks whose bases are there.

        Raises:
            BitstreamError: If it takes more memory than a stream of so many bytes may.
        """
        blocks, bases, time = self._spans.motion_blocks(group), self.info.bases, self.info.timeline
        heads, moves, held = list[np.ndarray](), list[PacketMoves](), self.scene_bytes
        spoken, num = np.zeros(self._num_tracks, bool), 0
        num_bytes = max(self._num_bytes, sum(self._sizes.values()))
        for packet in (packet for block in blocks for packet in self._packets.get(block, ())):
            num += packet.num_elements
            moved = self._ready.get(packet.id) or self._moved([packet], there)[0]
            if moved is None:
                continue
            rows, does = moved
            spoken[max(rows[0, TRACK] - rows[0, BEFORE], 0) : rows[-1, TRACK] + rows[-1, AFTER] + 1] = True
            heads.append(rows)
            moves.append(does)
            held += rows.nbytes + 2 * does.nbytes
            check_memory(held, num_bytes, f"the motion of {num:,} tracks")
        frames, complete = len(time.frames_of(group)), num == self.info.groups[group].motions
        offsets = Offsets(moves, frames, bases.unit, bases.size_log)
        return _sorted(np.concatenate([np.zeros((0, HEAD), np.int64), *heads]), offsets, spoken, complete, not blocks)

    def prepare(self, packets: Sequence[Packet], num_bytes: int, threads: int) -> None:
        """Decodes packets of motion whose bases are there before their group is asked for, so that less is left then.

        Args:
            packets: They, of one group; they are to be stored as well.
            num_bytes: Bytes of the stream that are there.
            threads: Threads to use.

        Raises:
            BitstreamError: If what is prepared takes more memory than a stream of so many bytes may.
        """
        there = self._received
        parts = [packets[begin : begin + TOGETHER] for begin in range(0, len(packets), TOGETHER)]
        decoded = ordered_map(lambda part: self._moved(part, there), parts, 1 if len(parts) == 1 else threads)
        for part, found in zip(parts, decoded, strict=True):
            for packet, moved in zip(part, found, strict=True):
                if moved is None:
                    continue
                self._ready[packet.id] = moved
                self._held += moved[0].nbytes + moved[1].nbytes
                check_memory(self._held, num_bytes, "motion that is ready")

    def _moved(self, packets: Sequence[Packet], there: np.ndarray) -> list["_Moved | None"]:
        """What packets of a group's motion say; None of one that speaks of nobody, or whose bases are missing."""
        group, _ = self._spans.of(packets[0].id.block)
        counts = np.array([packet.num_elements for packet in packets])
        payloads, first_new = [packet.payload for packet in packets], self._spans.first_new[group]
        heads, residuals, orders = decode_motion(self.info, group, counts, payloads, first_new)
        tracks = heads[:, TRACK]
        good = (tracks >= 0) & (tracks < self._num_tracks)  # bytes that no encoder wrote may name others
        own = self._rows[np.where(good, tracks, 0)]
        places, shifts = own[:, :3], motion_shifts(own, self.info.bases, self.info.coarser)
        found, end = list["_Moved | None"](), 0
        for count, order in zip(counts.tolist(), orders, strict=True):
            begin, end = end, end + count
            some = slice(begin, end) if good[begin:end].all() else begin + np.flatnonzero(good[begin:end])
            known = good[begin:end].any() and there[tracks[some]].all()
            does = coefficients_of(heads[some], residuals[some], order, places[some], shifts[some]) if known else None
            found.append(None if does is None else (heads[some], PacketMoves(does, order)))
        return found


def _sorted(heads: np.ndarray, offsets: Offsets, spoken: np.ndarray, complete: bool, unchanged: bool) -> GroupMotion:
    """Puts tracks of all packets in order; of one that is there twice the first counts."""
    tracks = heads[:, TRACK]
    first = np.arange(len(tracks))
    if (tracks[1:] <= tracks[:-1]).any():  # packets of an encoder are in order
        tracks, first = np.unique(tracks, return_index=True)
    moving = heads[:, STATE] == MOVING
    rows, some = np.where(moving, np.cumsum(moving) - 1, -1)[first], heads[first]
    begins = np.clip(some[:, BEGINS], 0, offsets.frames - 1)
    ends = np.clip(some[:, ENDS], begins, offsets.frames)
    return GroupMotion(tracks, moving[first], begins, ends, offsets.of(rows), spoken, complete, unchanged)


class _Spans:
    """Which block of a plan is what."""

    def __init__(self, info: ClipInfo, manifest: Manifest) -> None:
        plan = manifest.plan
        self._blocks: list[tuple[int, int | None]] = []
        self._tracks: list[tuple[int, int]] = []
        self._motion: dict[int, range] = {}
        births = [group.births for group in info.groups]
        self.first_new = np.concatenate([[0], np.cumsum(births)]).astype(np.int64).tolist()
        self.born = np.repeat(np.arange(len(births)), births)
        track = 0
        for tier, span in enumerate(plan.spans):
            group, bases = tier // 2, tier % 2 == 0
            blocks = range(span.first_block, span.first_block + span.num_blocks)
            if not bases:
                self._motion[group] = blocks
            for block in blocks:
                self._blocks.append((group, len(self._tracks) if bases else None))
                if bases:
                    self._tracks.append((track, span.block_elements(block)))
                    track += span.block_elements(block)

    def of(self, block: int) -> tuple[int, int | None]:
        """Group of a block, and which block of bases it is; None for motion."""
        return self._blocks[block]

    def blocks_of_tracks(self) -> np.ndarray:
        """Block of the plan that each track's base is in, int64 (T)."""
        blocks = [block for block, (_, base) in enumerate(self._blocks) if base is not None]
        return np.repeat(np.array(blocks, np.int64), [count for _, count in self._tracks])

    def tracks_of(self, base: int) -> tuple[int, int]:
        """First track of a block of bases, and how many there are."""
        return self._tracks[base]

    def motion_blocks(self, group: int) -> range:
        """Blocks of a group's motion."""
        return self._motion.get(group, range(0))


def update_digest(digest: Any, rows: Rows) -> None:
    """Adds the integers of one block, of bases or of motion, to a hashlib object."""
    (digest_motion if rows[0].shape[1] == HEAD else digest_bases)(digest, rows)
