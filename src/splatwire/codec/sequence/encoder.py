"""Encodes sequences of moving Gaussians to packets, one group of frames after another."""

import functools
import hashlib
import itertools
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np

from splatwire.bitstream import (
    HEADER_BYTES,
    Manifest,
    Packet,
    PacketId,
    Packetization,
    SceneStream,
    make_packet,
    make_stream,
)
from splatwire.bitstream.limits import TRACKS
from splatwire.bitstream.tiers import TierCounts
from splatwire.codec.background import BACKGROUND_SECTION
from splatwire.codec.gaussians.attributes import update_digest as digest_keyframes
from splatwire.codec.gaussians.quality import Quality
from splatwire.codec.sequence.fitting import Fitting, fit, motion_masks
from splatwire.codec.sequence.keyframes import KeyframeEncoder, even_block_size
from splatwire.codec.sequence.known_tracks import KnownTracks
from splatwire.codec.sequence.layout import (
    BEGINS,
    ENDS,
    GAP_AFTER,
    GAP_BEFORE,
    MAX_COEFFICIENT,
    MAX_QUANTISED,
    MOVING,
    NUM_CONTEXTS,
    STATE,
    TRACK,
)
from splatwire.codec.sequence.lifetimes import PACKET_BYTES_PER_LIFETIME, Lifetimes, lifetimes_sections
from splatwire.codec.sequence.motion_coder import INITIAL_TRACK_BYTES, MotionCoder, all_stay
from splatwire.codec.sequence.motion_rows import update_digest as digest_motion
from splatwire.codec.sequence.sending import by_importance, interleave_blocks
from splatwire.codec.sequence.side_info import GroupCounts, SequenceInfo, write_side_info
from splatwire.codec.sequence.track_group import TrackGroup
from splatwire.codec.sequence.trajectories import MotionCoefficients, Trajectories
from splatwire.codec.threads import ordered_map
from splatwire.errors import InvalidValueError
from splatwire.types.background import BLACK, Background
from splatwire.types.sequence_scene import Timeline
from splatwire.version import __version__

LOG = logging.getLogger(__name__)
SEQUENCE_PACKETIZATION = Packetization(block_size=4800, lanes=1, grouping="hashed", packet_bytes=1150)
"""Default packetization of sequences: packets that fit a datagram, in blocks of thousands of tracks, so that most
neighbours of a lost track are received. Blocks of 1200 tracks take 0.82 to 0.93 of the bytes, but a packet is then most
of a block: 20 % packet loss costs 4.7 dB with such blocks, and 0.6 dB with this packetization.
"""
LOG_STEP_RATIOS = np.array([2, 3, 2, 2, 2], dtype=np.int64)
"""log2 of the ratio of the quantisation steps of motion to those of keyframe Gaussians, for each kind of channel in
`layout.KINDS`.
"""
LIVE_GROUPS = 2
"""Number of latest groups of frames with track lifetimes in the side information of a live stream. For older groups,
lifetimes are only in the motion packets.
"""


class TracksEncoder:
    """Encoder of sequences of moving Gaussians, which takes one group of frames at a time.

    Args:
        rate: Frames per second.
        group_frames: Number of frames per group; only the last group may have fewer.
        quality: Quality setting, from which the quantisation steps of keyframe Gaussians are derived.
        background: RGB background colour.
        packetization: Parameters of the division into packets; the grouping must be "hashed".
        threads: Number of threads; None for one per processor.

    Attributes:
        importance: Importance of each packet returned by the last call of `add`, by packet id.

    Raises:
        InvalidValueError: If the grouping is not "hashed".
    """

    def __init__(
        self, rate: Fraction, group_frames: int, quality: Quality, background: Background = BLACK,
        packetization: Packetization = SEQUENCE_PACKETIZATION, threads: int | None = None,
    ) -> None:  # fmt: skip
        if not packetization.hashed:
            raise InvalidValueError("packets of a clip are cut by their size: choose hashed grouping")
        self._rate, self._group_frames = rate, group_frames
        self._packetization, self._threads = packetization, threads
        self._sections: Mapping[str, bytes] = BACKGROUND_SECTION.sections(background)
        self._keyframe_encoder = KeyframeEncoder(quality, packetization, threads)
        self._zero_probabilities: np.ndarray | None = None
        self._groups: list[GroupCounts] = []
        self._lifetimes: list[Lifetimes] = []
        self._packets: list[Packet] = []
        self._num_blocks = self._num_frames = self._num_tracks = 0
        self._digest = hashlib.sha256()
        self._known = KnownTracks.empty()
        self._fitting: Fitting | None = None
        self.importance: dict[PacketId, float] = {}
        self._costs = np.zeros(0)

    def fit_early(self, keys: np.ndarray, trajectories: Trajectories, end: int) -> None:
        """Fits the motion of the next group to its frames so far, in advance, so that `add` returns sooner.

        Optional: `add` fits whatever is missing. Without effect in the first group.

        Args:
            keys: Keys (identifiers) of the group's tracks so far, see `TrackGroup`.
            trajectories: Trajectories of these tracks over all frames of the group.
            end: Number of available frames; frames from `end` on may have any content.
        """
        if self._groups:
            self._fitting = self._fitting or self._new_fitting(keys, trajectories)
            self._fitting.add_frames(trajectories, end)

    def add(self, group: TrackGroup, class_offsets: np.ndarray | None = None, *, cut: bool = False) -> list[Packet]:
        """Encodes the next group of frames.

        A Gaussian that moved too far from its keyframe Gaussian gets a new one, which begins a second track of the
        stream with the same key.

        Args:
            group: The tracks of the group.
            class_offsets: Class offset of each track, which selects its quantisation steps: 0 for the finest steps,
                negative for coarser ones; None for a default.
            cut: True if another scene begins in the group.

        Returns:
            Packets of the group in sending order, without a stream id: keyframe Gaussians of new tracks, then motion.

        Raises:
            InvalidValueError: If the first group contains no Gaussian with a visible effect, or a track is too far away
                from the others.
        """
        if not len(group.keys) and not self._groups:
            raise InvalidValueError("there is no Gaussian that draws anything in the first frames")
        if not len(group.keys) and len(self._known.alive):  # a group without tracks would mean that all stay unchanged
            group = self._known.empty_group(group.trajectories.num_frames)
        self.importance = {}
        first_new = self._num_tracks
        track_indices, needs_keyframe, moving, motion = self._classify_tracks(group)
        continued_rows, keyframe_rows = np.flatnonzero(~needs_keyframe), np.flatnonzero(needs_keyframe)
        num_continued = len(continued_rows)
        coding_rows = np.concatenate([continued_rows[np.argsort(track_indices[continued_rows])], keyframe_rows])
        self._num_tracks += len(keyframe_rows)
        self._costs = np.concatenate([self._costs, np.full(len(keyframe_rows), INITIAL_TRACK_BYTES)])
        max_payload_bytes = self._packetization.packet_bytes - HEADER_BYTES
        coder = MotionCoder.of(len(coding_rows), motion.coefficients, first_new, max_payload_bytes)

        @functools.cache
        def ensure_births_encoded() -> list[Packet]:
            """Encodes the keyframe Gaussians of the tracks that begin in this group, and fits their motion.

            The first call does the work; later calls return the same packets.
            """
            packets = self._encode_keyframes(group, class_offsets, keyframe_rows, track_indices, cut=cut)
            threads, fitted_tracks = 1 if num_continued else self._threads, np.where(needs_keyframe, track_indices, -1)
            frame_range = (0, group.trajectories.num_frames)
            fit(
                motion,
                group.trajectories,
                self._known,
                self._keyframe_encoder.motion_unit_info,
                fitted_tracks,
                frame_range,
                threads,
            )
            largest, rotations = motion.largest[keyframe_rows], motion.largest_rotation[keyframe_rows]
            shifts = self._known.shifts[track_indices[keyframe_rows]]
            _, moving[keyframe_rows] = motion_masks(largest, rotations, shifts, np.arange(len(keyframe_rows)))
            _warn_of_clipped_motion(largest, shifts)
            coding_rows[num_continued:] = keyframe_rows[np.argsort(track_indices[keyframe_rows])]
            self._fill_coder(coder, slice(num_continued, None), group, coding_rows, track_indices, moving)
            return packets

        self._fill_coder(coder, slice(num_continued), group, coding_rows, track_indices, moving)
        if cut:
            old_log2_unit = self._keyframe_encoder.log2_motion_unit
            ensure_births_encoded()
            self._change_unit(motion, continued_rows, track_indices, moving, old_log2_unit)
            self._fill_coder(coder, slice(num_continued), group, coding_rows, track_indices, moving)
        num_motion_tracks, motion_packets = self._encode_motion(group, coder, num_continued, ensure_births_encoded)
        self._groups.append(GroupCounts(len(keyframe_rows), num_motion_tracks))
        packets = [*ensure_births_encoded(), *motion_packets]
        max_lifetimes = sum(packet.num_bytes for packet in packets) // PACKET_BYTES_PER_LIFETIME
        coded_tracks, begins, ends = track_indices[coding_rows], group.begins[coding_rows], group.ends[coding_rows]
        begin_late, end_early = (coded_tracks >= first_new) & (begins > 0), ends < group.trajectories.num_frames
        lifetimes = Lifetimes(
            coded_tracks[begin_late], begins[begin_late], coded_tracks[end_early], self._num_frames + ends[end_early]
        )
        ended = np.setdiff1d(self._known.alive, coded_tracks, assume_unique=True)
        lifetimes = lifetimes.with_ended(ended, self._num_frames)
        self._lifetimes.append(lifetimes.without_least_visible(self._known.visibility, max_lifetimes))
        self._known = replace(self._known, alive=coded_tracks[~end_early])
        self._num_frames += group.trajectories.num_frames
        self._packets += packets
        return by_importance(ensure_births_encoded(), self.importance) + interleave_blocks(
            motion_packets, self.importance
        )

    def finish(self, sections: Mapping[str, bytes]) -> SceneStream:
        """Returns the stream of all groups of frames.

        Args:
            sections: Additional named sections of the side information, content by name.
        """
        side_info, tiers = self._header(sections, self._lifetimes)
        return make_stream(
            packetization=self._packetization, num_elements=sum(tier.num_elements for tier in tiers),
            side_info=side_info, packets=self._packets, symbols_digest=self._digest.hexdigest(),
            writer=f"splatwire {__version__}", tiers=tiers, schema_name=TRACKS,
        )  # fmt: skip

    def current_header(self, sections: Mapping[str, bytes], stream_id: int) -> tuple[Manifest, bytes]:
        """Returns manifest and side information of a live stream, for the groups of frames encoded up to now.

        Args:
            sections: Additional named sections of the side information, content by name.
            stream_id: Id of the live stream.
        """
        side_info, tiers = self._header(sections, self._lifetimes[-LIVE_GROUPS:])
        manifest = Manifest(
            packetization=self._packetization, num_elements=sum(tier.num_elements for tier in tiers),
            num_packets=len(self._packets), stream_id=stream_id, side_info_bytes=len(side_info),
            side_info_digest=hashlib.sha256(side_info).hexdigest(), symbols_digest=self._digest.hexdigest(),
            writer=f"splatwire {__version__}", tiers=tiers, schema_name=TRACKS,
        )  # fmt: skip
        return manifest, side_info

    def _header(
        self, sections: Mapping[str, bytes], lifetimes: Sequence[Lifetimes]
    ) -> tuple[bytes, tuple[TierCounts, ...]]:
        """Returns the side information of the frames encoded so far, and the sizes of the stream's tiers.

        A tier is a part of the stream with separate packets. Each group of frames has two: its keyframe Gaussians, and
        its motion.
        """
        timeline = Timeline(self._rate, self._num_frames, self._group_frames)
        zero_probabilities = (
            np.full(NUM_CONTEXTS, 128) if self._zero_probabilities is None else self._zero_probabilities
        )
        all_sections = {**self._sections, **sections, **lifetimes_sections(Lifetimes.joined(lifetimes))}
        info = SequenceInfo(
            timeline,
            tuple(self._groups),
            self._keyframe_encoder.shots,
            LOG_STEP_RATIOS,
            zero_probabilities,
            all_sections,
        )
        tiers = tuple(
            TierCounts(count, 1) for group in self._groups for count in (group.num_births, group.num_motion_tracks)
        )
        return write_side_info(info), tiers

    def _classify_tracks(self, group: TrackGroup) -> tuple[np.ndarray, np.ndarray, np.ndarray, MotionCoefficients]:
        """Determines which tracks of a group need a new keyframe Gaussian, and which tracks move.

        A track needs a new keyframe Gaussian if the track is new, or if it moves too far away from its present keyframe
        Gaussian.

        Returns:
            Four items: index of each track in the stream, -1 for new tracks, int64 (n); mask of the tracks that need a
            new keyframe Gaussian, bool (n); mask of the moving tracks, bool (n); and the motion of the tracks.
        """
        count, num_frames = len(group.keys), group.trajectories.num_frames
        fitting, self._fitting = self._fitting, None
        if not self._groups:
            return (
                np.full(count, -1),
                np.ones(count, bool),
                np.zeros(count, bool),
                MotionCoefficients.zero(count, num_frames),
            )
        if fitting is None or not fitting.can_continue(group.keys, num_frames):
            fitting = self._new_fitting(group.keys, group.trajectories)
            fitting.add_frames(group.trajectories, num_frames)
        motion = fitting.finish(group.keys, group.trajectories, (group.begins == 0) & (group.ends == num_frames))
        new = fitting.track_indices < 0
        known_indices = np.maximum(fitting.track_indices, 0)
        _, shifts = self._known.in_units(slice(None), self._keyframe_encoder.log2_motion_unit)
        too_far, moving = motion_masks(motion.largest, motion.largest_rotation, shifts, known_indices)
        restarted_rows = np.flatnonzero(too_far & ~new)
        motion.put(restarted_rows, MotionCoefficients.zero(len(restarted_rows), num_frames))
        return fitting.track_indices, new | too_far, moving, motion

    def _change_unit(
        self,
        motion: MotionCoefficients,
        continued_rows: np.ndarray,
        track_indices: np.ndarray,
        moving: np.ndarray,
        old_log2_unit: int,
    ) -> None:
        """Converts the motion of continued tracks to the unit of motion of a new shot.

        A scene cut may begin a new shot: groups of frames with a lattice, quantisation steps and tables of their own.
        Continued tracks keep the keyframe Gaussian of an earlier group.

        Args:
            motion: Motion of the group's tracks, changed in place.
            continued_rows: Indices, among the tracks of the group, of the continued tracks.
            track_indices: Index in the stream of each track of the group.
            moving: Mask of moving tracks; cleared for tracks whose motion is too large for the new unit.
            old_log2_unit: The unit of motion of the preceding shot, which is the unit of `motion` before the call.
                Given as log2 of the ratio of this unit to the unit of the first shot.
        """
        log2_unit = self._keyframe_encoder.log2_motion_unit
        if log2_unit == old_log2_unit or not len(continued_rows):
            return
        motion.rescale_positions(continued_rows, old_log2_unit - log2_unit)
        _, shifts = self._known.in_units(track_indices[continued_rows], log2_unit)
        largest, rotations = motion.largest[continued_rows], motion.largest_rotation[continued_rows]
        too_far, _ = motion_masks(largest, rotations, shifts, np.arange(len(continued_rows)))
        stopped = moving[continued_rows] & too_far
        moving[continued_rows[stopped]] = False
        if stopped.any():
            LOG.warning(
                "%s Gaussians of the scene before a cut stand still in the %d frames around it: the new scene is too "
                "small for their motion", f"{stopped.sum():,}", self._group_frames,
            )  # fmt: skip

    def _new_fitting(self, keys: np.ndarray, trajectories: Trajectories) -> Fitting:
        return Fitting(
            keys, self._known, self._keyframe_encoder.motion_unit_info, trajectories.num_frames, self._threads
        )

    def _encode_keyframes(
        self,
        group: TrackGroup,
        class_offsets: np.ndarray | None,
        keyframe_rows: np.ndarray,
        track_indices: np.ndarray,
        *,
        cut: bool,
    ) -> list[Packet]:
        """Encodes the keyframe Gaussians of tracks that begin in a group, and assigns stream indices to the tracks.

        Args:
            group: The tracks of the group of frames.
            class_offsets: Class offset of each track of the group; None for the default class.
            keyframe_rows: Indices, among the tracks of the group, of those that need a new keyframe Gaussian.
            track_indices: Index in the stream of each track of the group; changed in place for new tracks.
            cut: True if another scene begins in the group.
        """
        if not len(keyframe_rows):
            return []
        coded = self._keyframe_encoder.encode(
            group.keyframe_gaussians(keyframe_rows),
            None if class_offsets is None else class_offsets[keyframe_rows],
            len(self._groups),
            cut=cut,
        )
        track_rows = keyframe_rows[coded.order]
        source_keyframes = group.trajectories.at(track_rows, np.zeros_like(track_rows))
        shifts = self._keyframe_encoder.shifts_of(coded.rows, LOG_STEP_RATIOS)
        first_new = len(self._known.keys)
        self._known = self._known.with_births(
            source_keyframes, group.keys[track_rows], coded.positions, shifts, self._keyframe_encoder.log2_motion_unit
        )
        for rows in coded.block_rows:
            digest_keyframes(self._digest, rows)
        track_indices[track_rows] = np.arange(first_new, len(self._known.keys))
        return self._renumbered(coded.packets, coded.num_blocks, self._known.visibility[first_new:])

    def _fill_coder(
        self, coder: MotionCoder, entries: slice, group: TrackGroup, group_rows: np.ndarray, track_indices: np.ndarray,
        moving: np.ndarray,
    ) -> None:  # fmt: skip
        """Writes headers, positions, quantisation steps and expected sizes of a range of tracks into a motion coder.

        Tracks are Gaussians over time. The coder has an entry for each track with coded motion.

        Args:
            coder: The motion coder, changed in place.
            entries: Range of the coder's entries to fill.
            group: The tracks of the group of frames.
            group_rows: For each entry of the coder, the index of its track within the group.
            track_indices: For each track of the group, its index within the stream.
            moving: Mask of moving tracks of the group.
        """
        rows, known_tracks, tracks = group_rows[entries], self._known, track_indices[group_rows[entries]]
        headers = coder.headers[entries]
        previous_track = coder.headers[entries.start - 1, TRACK] if entries.start else -1
        headers[:, TRACK], headers[:, BEGINS], headers[:, ENDS] = tracks, group.begins[rows], group.ends[rows]
        headers[:, GAP_BEFORE] = np.diff(tracks, prepend=previous_track) - 1
        headers[:, STATE] = np.where(moving[rows], MOVING, 0)
        if len(rows) and len(rows) + (entries.start or 0) == len(group_rows):
            headers[-1, GAP_AFTER] = self._num_tracks - 1 - tracks[-1]
        coder.rows[entries], coder.costs[entries] = rows, self._costs[tracks]
        coder.positions[entries], coder.shifts[entries] = known_tracks.in_units(
            tracks, self._keyframe_encoder.log2_motion_unit
        )

    def _encode_motion(
        self,
        group: TrackGroup,
        coder: MotionCoder,
        num_continued: int,
        ensure_births_encoded: Callable[[], list[Packet]],
    ) -> tuple[int, list[Packet]]:
        """Encodes the motion of all tracks (Gaussians over time) in a group of frames.

        Args:
            group: The tracks of the group.
            coder: Motion coder of the tracks. Continued tracks come first. Tracks with a new keyframe Gaussian follow;
                `ensure_births_encoded` fills their entries.
            num_continued: Number of tracks that continue with the keyframe Gaussian of an earlier group.
            ensure_births_encoded: Function that encodes the keyframe Gaussians of the new tracks, and fills the entries
                of the new tracks in `coder`. The first call does the work; later calls return the same packets.

        Returns:
            Number of tracks with coded motion, and their packets; (0, []) if nothing changes.
        """
        headers, num_frames = coder.headers, group.trajectories.num_frames
        if all_stay(headers[:num_continued], num_frames) and np.array_equal(
            self._known.alive, headers[:num_continued, TRACK]
        ):
            ensure_births_encoded()
            if all_stay(headers, num_frames):
                return 0, []
        packets, self._costs[headers[:, TRACK]] = self._encode_motion_blocks(
            coder, num_continued, ensure_births_encoded
        )
        return len(headers), packets

    def _encode_motion_blocks(
        self, coder: MotionCoder, num_continued: int, ensure_births_encoded: Callable[[], list[Packet]]
    ) -> tuple[list[Packet], np.ndarray]:
        """Encodes the motion of all tracks (Gaussians over time) in packets of limited size.

        Blocks without new tracks can be encoded before the keyframe Gaussians of the new tracks.

        Args:
            coder: Motion coder of the tracks, as for `_encode_motion`.
            num_continued: Number of continued tracks, as for `_encode_motion`.
            ensure_births_encoded: Function that encodes the keyframe Gaussians of the new tracks, as for
                `_encode_motion`.

        Returns:
            Packets of all tracks, and the number of bytes used for each track, float64.
        """
        headers = coder.headers
        block_size = even_block_size(len(headers), self._packetization.block_size)
        block_ranges = list(itertools.pairwise([*range(0, len(headers), block_size), len(headers)]))
        if self._zero_probabilities is None:
            ensure_births_encoded()
            self._zero_probabilities = coder.fit_zero_probabilities(block_ranges, self._threads)

        def ranges_to_encode() -> Iterator[tuple[int, int]]:
            for begin, end in block_ranges:
                if end > num_continued:
                    ensure_births_encoded()
                yield begin, end

        packets, costs = [], []
        encode = functools.partial(coder.encode, self._zero_probabilities)
        coded_blocks = ordered_map(encode, ranges_to_encode(), self._threads)
        for block, ((begin, end), coded) in enumerate(zip(block_ranges, coded_blocks, strict=True)):
            ensure_births_encoded()  # keyframe Gaussians first: this is the order of the digest
            packets += coded.packets(block)
            digest_motion(self._digest, (headers[begin:end], coded.residuals))
            costs.append(coded.costs)
        moving_visibility = self._known.visibility[headers[:, TRACK]] * (headers[:, STATE] == MOVING)
        return self._renumbered(packets, len(block_ranges), moving_visibility), np.concatenate(costs)

    def _renumbered(self, packets: list[Packet], num_blocks: int, visibility: np.ndarray) -> list[Packet]:
        """Gives newly encoded packets the next block numbers of the stream, and records the importance of each packet.

        Args:
            packets: The packets, with blocks numbered from 0.
            num_blocks: Number of blocks of the packets.
            visibility: Visibility of each element of the packets (squared opacity times area); 0 for still tracks.
        """
        first_block = self._num_blocks
        self._num_blocks += num_blocks
        renumbered = [
            make_packet(PacketId(first_block + p.id.block, p.id.index_in_block), p.num_elements, p.payload)
            for p in packets
        ]
        starts = np.cumsum([0, *(packet.num_elements for packet in packets)])[:-1]
        importance = np.add.reduceat(visibility, starts).tolist()
        self.importance |= {packet.id: value for packet, value in zip(renumbered, importance, strict=True)}
        return renumbered


def _warn_of_clipped_motion(largest: np.ndarray, shifts: np.ndarray) -> None:
    """Logs a warning if motion of n tracks (Gaussians over time) exceeds the largest coefficient that can be coded.

    Args:
        largest: Largest absolute motion coefficient of each track in each channel, in the units of `layout.CHANNELS`,
            float64 (n, channels).
        shifts: log2 of the quantisation step of each channel's motion, int64 (n, channels).
    """
    num_clipped = int((largest > np.minimum(MAX_COEFFICIENT, np.ldexp(float(MAX_QUANTISED), shifts))).any(axis=1).sum())
    if num_clipped:
        LOG.warning(
            "%s Gaussians move too far for their size: their decoded motion ends early. Enlarge them",
            f"{num_clipped:,}",
        )
