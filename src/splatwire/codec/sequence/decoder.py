"""Decoder of sequences of moving Gaussians."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from splatwire.bitstream import Manifest, Packet, PacketId
from splatwire.bitstream.origin import ORIGIN_SECTION
from splatwire.codec.antialiasing import SECTION as ANTIALIASED
from splatwire.codec.background import BACKGROUND_SECTION
from splatwire.codec.gaussians.attributes import empty_rows as empty_keyframes
from splatwire.codec.gaussians.attributes import update_digest as digest_keyframes
from splatwire.codec.gaussians.decoder import blank_splats, decode_packets, store_block
from splatwire.codec.gaussians.layout import COLUMNS
from splatwire.codec.memory import check_memory, packet_reader_bytes
from splatwire.codec.metadata import read_metadata
from splatwire.codec.named_sections import concealer_sections
from splatwire.codec.schema import DecodedRows, PacketBatch
from splatwire.codec.sequence.keyframes import to_motion_units
from splatwire.codec.sequence.layout import (
    BEGINS,
    ENDS,
    GAP_AFTER,
    GAP_BEFORE,
    HEADER_FIELDS,
    MOVING,
    NUM_CHANNELS,
    STATE,
    TRACK,
)
from splatwire.codec.sequence.motion_rows import coefficients_of, decode_motion
from splatwire.codec.sequence.motion_rows import update_digest as digest_motion
from splatwire.codec.sequence.side_info import SequenceInfo, open_side_info
from splatwire.codec.sequence.steps import in_other_units, motion_shifts
from splatwire.codec.sequence.trajectories import MotionEvaluator, PacketMotion
from splatwire.codec.threads import ordered_map
from splatwire.types import LossMask, ReceivedScene
from splatwire.types.sequence_scene import GroupMotion, SequenceScene, Tracks

BYTES_PER_SHOWN_TRACK = 768
"""Memory per track for concealment and rendering of a group of frames, in addition to the keyframe Gaussian and the
motion of the track, bytes.
"""

PACKETS_PER_CALL = 8
"""Number of motion packets that one call decodes if motion is decoded ahead of time, see `TracksDecoder.predecode`."""

_DecodedMotion = tuple[np.ndarray, PacketMotion]
"""Decoded packet of motion: headers of its tracks, int64 (n, HEADER_FIELDS), and the motion coefficients of its moving
tracks.
"""


class TracksDecoder:
    """Decodes packets of moving Gaussians to a sequence; implements `splatwire.codec.schema.Decoder`.

    Args:
        manifest: The stream's manifest.
        side_info: The stream's side information, serialised.
        num_bytes: Number of bytes received of the stream, from which memory limits are derived.

    Raises:
        MissingSideInfoError: If the side information is empty.
        BitstreamError: If the side information is damaged or contradicts the manifest.
    """

    order: np.ndarray | None = None
    batches_are_blocks, packets_independent, redecode_on_demand = True, True, True

    def __init__(self, manifest: Manifest, side_info: bytes, num_bytes: int) -> None:
        info, self.manifest = open_side_info(manifest, side_info), manifest
        self.info, self._plan, self._num_elements = info, manifest.plan, manifest.num_elements
        self.sections = info.sections
        self._block_map = _BlockMap(info, manifest)
        self._log2_motion_units = info.log2_motion_units
        self._num_tracks = sum(group.num_births for group in info.groups)
        self._num_bytes, num_sh_values = num_bytes, 3 * (info.keyframe_info.degree + 1) ** 2
        self.scene_bytes = (
            self._num_tracks * (4 * (12 + num_sh_values) + 24 + NUM_CHANNELS + 24 + BYTES_PER_SHOWN_TRACK)
            + self._num_elements
        )
        group_frames = info.timeline.group_frames
        self.row_bytes = max(
            8 * int(COLUMNS) + 4 * info.keyframe_info.num_harmonic_columns,
            8 * HEADER_FIELDS + 4 * NUM_CHANNELS * group_frames,
        )

    def working_bytes(self, packets: Sequence[Packet]) -> int:
        """Returns the memory that each decoding thread needs in addition to the scene, bytes."""
        # Integers of several pending blocks, and words of the largest packet.
        largest = max((span.block_size for span in self._plan.spans if span.num_elements), default=0)
        return largest * (4 * self.row_bytes + 64) + (4 << 20) + packet_reader_bytes(packets)

    def allocate(self, threads: int | None, progress: Callable[[float], None] | None = None) -> None:
        """Allocates the arrays for the keyframe Gaussians of all tracks, and marks all as not received.

        Args:
            threads: Not used.
            progress: Not used.
        """
        self._lifetimes = self.info.lifetimes.by_track(self._num_tracks, self.info.timeline.num_frames)
        self._splats = blank_splats(self._num_tracks, self.info.keyframe_info.degree)
        self._positions = np.zeros((self._num_tracks, 3), np.int64)
        self._shifts = np.zeros((self._num_tracks, NUM_CHANNELS), np.int8)
        self._rounding = np.zeros(self._num_tracks, np.float32)
        self._received = np.zeros(self._num_tracks, dtype=np.bool_)
        self._loss_mask = LossMask.of_elements(np.zeros(self._num_elements, dtype=np.bool_))
        self._motion_packets: dict[int, tuple[Packet, ...]] = {}
        self._block_bytes: dict[int, int] = {}
        self._predecoded: dict[PacketId, _DecodedMotion] = {}
        self._memory_bytes = self.scene_bytes

    def copy_keyframes_from(self, other: "TracksDecoder") -> None:
        """Copies the keyframe Gaussians that an earlier decoder of the same live stream has decoded.

        Call `allocate` before this method.

        Args:
            other: Decoder of the same stream for fewer groups of pictures, before the stream was extended.
        """
        num_earlier = other._num_tracks
        for name in ("means", "quats", "scales", "opacities", "sh"):
            getattr(self._splats, name)[:num_earlier] = getattr(other._splats, name)
        self._positions[:num_earlier], self._shifts[:num_earlier] = other._positions, other._shifts
        self._received[:num_earlier] = other._received
        self._rounding[:num_earlier] = other._rounding
        self._loss_mask.received[: other._num_elements] = other._loss_mask.received

    def decode(self, batch: PacketBatch) -> DecodedRows:
        """Decodes the received packets of one block to integers.

        Args:
            batch: The packets: either all with keyframe Gaussians, or all with motion.

        Returns:
            Two arrays with a row for each element. For keyframe Gaussians: all attributes except spherical harmonics,
            and the harmonics. For motion: headers and prediction residuals of the tracks.
        """
        group, keyframe_block = self._block_map.of(batch.block)
        if keyframe_block is not None:
            return decode_packets(*self.info.shot_of(keyframe_block), batch.counts, batch.payloads)
        return decode_motion(self.info, group, batch.counts, batch.payloads, self._block_map.first_new[group])[:2]

    def store(self, batch: PacketBatch, rows: DecodedRows) -> None:
        """Writes decoded keyframe Gaussians to the scene. Motion packets are kept and decoded on request.

        Args:
            batch: Received packets of one block.
            rows: Result of `decode` for these packets.
        """
        _, keyframe_block = self._block_map.of(batch.block)
        self._loss_mask.received[batch.indices] = True
        if keyframe_block is None:
            # Packets take a hundredth of the memory of decoded motion.
            self.store_motion(batch.block, batch.packets)
            return
        self._block_bytes[batch.block] = sum(packet.num_bytes for packet in batch.packets)
        first, count = self._block_map.track_range(keyframe_block)
        received = np.zeros(count, dtype=bool)
        block_rows, harmonics = empty_keyframes(count, self.info.keyframe_info.num_harmonic_columns)
        begin = 0
        for packet in batch.packets:
            start, end = packet.id.index_in_block, begin + packet.num_elements
            members = slice(start, start + packet.num_elements)
            received[members] = True
            block_rows[members], harmonics[members] = rows[0][begin:end], rows[1][begin:end]
            begin = end
        tracks = np.arange(first, first + count)
        info, block = self.info.shot_of(keyframe_block)
        lattice_shift = self.info.lattice_shift(keyframe_block)
        store_block(self._splats, tracks, block_rows, harmonics, received, info, block)
        self._positions[tracks] = to_motion_units(block_rows, info, block, lattice_shift)
        self._shifts[tracks] = motion_shifts(block_rows, info, self.info.log_step_ratios, lattice_shift)
        self._received[tracks] = received
        exponents = self._shifts[tracks, 0].astype(np.int32) + info.size_log - info.lattice_bits - lattice_shift - 1
        self._rounding[tracks] = np.ldexp(received.astype(np.float32), exponents)

    def store_motion(self, block: int, packets: tuple[Packet, ...]) -> None:
        """Stores the received packets of a block of motion, to decode them when their frames are requested.

        Args:
            block: Index of the block.
            packets: The packets, in the order of their indices in the block.
        """
        self._motion_packets[block] = packets
        self._block_bytes[block] = sum(packet.num_bytes for packet in packets)

    def update_digest(self, digest: Any, rows: DecodedRows) -> None:
        """Adds the decoded integers of one block to a hash, with which receivers verify their decoding."""
        update_digest(digest, rows)

    def scene(self) -> ReceivedScene[SequenceScene]:
        """Returns the sequence decoded so far, with the mask of received elements and the stream's metadata."""
        blocks = self._block_map.blocks_of_tracks()
        tracks = Tracks(self._splats, self._block_map.born, self._received, blocks, self._rounding, *self._lifetimes)
        background, antialiased = BACKGROUND_SECTION.read(self.sections), ANTIALIASED in self.sections
        sequence = SequenceScene(
            self.info.timeline, tracks, self._motion, self._num_elements, background, antialiased,
            origin=ORIGIN_SECTION.read(self.sections),
            metadata=read_metadata(self.sections),
        )  # fmt: skip
        return ReceivedScene(sequence, self._loss_mask, concealer_sections(self.sections))

    def _motion(self, group: int, received: np.ndarray) -> GroupMotion:
        """Decodes the received motion packets of one group of frames.

        Args:
            group: Index of the group of frames.
            received: Mask of tracks with a received keyframe Gaussian, bool (T).

        Raises:
            BitstreamError: If the decoded motion exceeds the stream's memory limit.
        """
        blocks, info = self._block_map.motion_blocks(group), self.info.keyframe_info
        headers, moving_packets, memory_bytes = list[np.ndarray](), list[PacketMotion](), self.scene_bytes
        covered, num_received = np.zeros(self._num_tracks, bool), 0
        num_bytes = max(self._num_bytes, sum(self._block_bytes.values()))
        for packet in (packet for block in blocks for packet in self._motion_packets.get(block, ())):
            num_received += packet.num_elements
            motion = self._predecoded.get(packet.id) or self._decode_packets([packet], received)[0]
            if motion is None:
                continue
            rows, packet_motion = motion
            covered[max(rows[0, TRACK] - rows[0, GAP_BEFORE], 0) : rows[-1, TRACK] + rows[-1, GAP_AFTER] + 1] = True
            headers.append(rows)
            moving_packets.append(packet_motion)
            memory_bytes += rows.nbytes + 2 * packet_motion.nbytes
            check_memory(memory_bytes, num_bytes, f"the motion of {num_received:,} tracks")
        num_frames = len(self.info.timeline.frames_of(group))
        complete = num_received == self.info.groups[group].num_motion_tracks
        size_log = info.size_log + int(self._log2_motion_units[group])
        evaluator = MotionEvaluator(moving_packets, num_frames, info.lattice_bits, size_log)
        return _combine_packets(
            np.concatenate([np.zeros((0, HEADER_FIELDS), np.int64), *headers]), evaluator, covered, complete, not blocks
        )

    def predecode(self, packets: Sequence[Packet], num_bytes: int, threads: int) -> None:
        """Decodes motion packets ahead of time, to show their frames without delay.

        Args:
            packets: Packets of one group of frames; they must also be passed to `store` or `store_motion`.
            num_bytes: Number of bytes received of the stream, from which the memory limit is derived.
            threads: Number of threads.

        Raises:
            BitstreamError: If the decoded motion exceeds the stream's memory limit.
        """
        received = self._received
        parts = [packets[begin : begin + PACKETS_PER_CALL] for begin in range(0, len(packets), PACKETS_PER_CALL)]
        decoded = ordered_map(
            lambda part: self._decode_packets(part, received), parts, 1 if len(parts) == 1 else threads
        )
        for part, motions in zip(parts, decoded, strict=True):
            for packet, motion in zip(part, motions, strict=True):
                if motion is None:
                    continue
                self._predecoded[packet.id] = motion
                self._memory_bytes += motion[0].nbytes + motion[1].nbytes
                check_memory(self._memory_bytes, num_bytes, "motion that is ready")

    def _decode_packets(self, packets: Sequence[Packet], received: np.ndarray) -> list["_DecodedMotion | None"]:
        """Decodes the given motion packets of one group of frames.

        Args:
            packets: The packets, at least one.
            received: Mask of tracks with a received keyframe Gaussian, bool (T).

        Returns:
            Headers and motion of each packet; None for a packet with damaged headers or missing keyframe Gaussians.
        """
        group, _ = self._block_map.of(packets[0].id.block)
        counts = np.array([packet.num_elements for packet in packets])
        payloads, first_new = [packet.payload for packet in packets], self._block_map.first_new[group]
        headers, residuals, num_coefficients = decode_motion(self.info, group, counts, payloads, first_new)
        tracks = headers[:, TRACK]
        is_valid = (tracks >= 0) & (tracks < self._num_tracks)  # malformed packets may contain other numbers
        clipped_tracks = np.where(is_valid, tracks, 0)
        log2_ratios = self._log2_motion_units[self._block_map.born[clipped_tracks]] - self._log2_motion_units[group]
        positions, shifts = in_other_units(
            self._positions[clipped_tracks], self._shifts[clipped_tracks].astype(np.int64), log2_ratios
        )
        motions, end = list["_DecodedMotion | None"](), 0
        for count, per_kind in zip(counts.tolist(), num_coefficients, strict=True):
            begin, end = end, end + count
            selection = slice(begin, end) if is_valid[begin:end].all() else begin + np.flatnonzero(is_valid[begin:end])
            has_all_keyframes = is_valid[begin:end].any() and received[tracks[selection]].all()
            coefficients = (
                coefficients_of(
                    headers[selection], residuals[selection], per_kind, positions[selection], shifts[selection]
                )
                if has_all_keyframes
                else None
            )
            motions.append(None if coefficients is None else (headers[selection], PacketMotion(coefficients, per_kind)))
        return motions


def _combine_packets(
    headers: np.ndarray, evaluator: MotionEvaluator, covered: np.ndarray, complete: bool, unchanged: bool
) -> GroupMotion:
    """Combines the decoded motion of all packets of a group of frames.

    Args:
        headers: Headers of the tracks of all packets, int64 (n, fields).
        evaluator: Motion of the moving tracks of all packets.
        covered: Mask of the tracks for which a packet was received, moving or not, bool (T).
        complete: True if all motion packets of the group were received.
        unchanged: True if the group contains no motion packets because nothing changes.
    """
    tracks = headers[:, TRACK]
    first_rows = np.arange(len(tracks))
    if (tracks[1:] <= tracks[:-1]).any():  # packets of an encoder are in order
        tracks, first_rows = np.unique(tracks, return_index=True)
    moving = headers[:, STATE] == MOVING
    rows, used_headers = np.where(moving, np.cumsum(moving) - 1, -1)[first_rows], headers[first_rows]
    begins = np.clip(used_headers[:, BEGINS], 0, evaluator.num_frames - 1)
    ends = np.clip(used_headers[:, ENDS], begins, evaluator.num_frames)
    return GroupMotion(tracks, moving[first_rows], begins, ends, evaluator.of(rows), covered, complete, unchanged)


class _BlockMap:
    """Map from each block of a packet plan to the block's group of frames."""

    def __init__(self, info: SequenceInfo, manifest: Manifest) -> None:
        plan = manifest.plan
        self._blocks: list[tuple[int, int | None]] = []
        self._track_ranges: list[tuple[int, int]] = []
        self._motion_blocks: dict[int, range] = {}
        births = [group.num_births for group in info.groups]
        self.first_new = np.concatenate([[0], np.cumsum(births)]).astype(np.int64).tolist()
        self.born = np.repeat(np.arange(len(births)), births)
        track = 0
        for group, (keyframes, motion) in enumerate(plan.gop_spans):
            for block in keyframes.blocks:
                self._blocks.append((group, len(self._track_ranges)))
                self._track_ranges.append((track, keyframes.block_elements(block)))
                track += keyframes.block_elements(block)
            self._motion_blocks[group] = motion.blocks
            self._blocks += [(group, None)] * motion.num_blocks

    def of(self, block: int) -> tuple[int, int | None]:
        """Returns two indices: the group of frames of a block, and the block's position among all keyframe blocks.

        A keyframe block contains keyframe Gaussians. All other blocks contain motion; for these, the second value is
        None.
        """
        return self._blocks[block]

    def blocks_of_tracks(self) -> np.ndarray:
        """Returns for each track the index of the block that contains its keyframe Gaussian, int64 (T)."""
        blocks = [block for block, (_, keyframe_block) in enumerate(self._blocks) if keyframe_block is not None]
        return np.repeat(np.array(blocks, np.int64), [count for _, count in self._track_ranges])

    def track_range(self, keyframe_block: int) -> tuple[int, int]:
        """Returns the tracks whose keyframe Gaussians are in a block: index of the first track, number of tracks.

        The tracks of a block have consecutive indices.

        Args:
            keyframe_block: Index of the block among all blocks of keyframe Gaussians.
        """
        return self._track_ranges[keyframe_block]

    def motion_blocks(self, group: int) -> range:
        """Returns the range of blocks that contain the motion of a group of frames."""
        return self._motion_blocks.get(group, range(0))


def update_digest(digest: Any, rows: DecodedRows) -> None:
    """Adds the decoded integers of one block to a hash, with which receivers verify their decoding.

    Args:
        digest: hashlib object that is updated.
        rows: Decoded integers of a block of keyframe Gaussians or of a block of motion, in two arrays.
    """
    (digest_motion if rows[0].shape[1] == HEADER_FIELDS else digest_keyframes)(digest, rows)
