"""Side information of a sequence, sent before the packets (docs/format.md)."""

import bisect
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from splatwire.bitstream import Manifest
from splatwire.bitstream.limits import MAX_FRAME_RATE, MAX_FRAMES, MAX_GROUP_FRAMES, SCHEMAS, TRACKS
from splatwire.bitstream.sections import read_sections, write_sections
from splatwire.codec.gaussians.side_info import SideInfo as KeyframeInfo
from splatwire.codec.gaussians.side_info import read_side_info as read_keyframe_info
from splatwire.codec.gaussians.side_info import write_side_info as write_keyframe_info
from splatwire.codec.sequence.layout import MAX_LOG2_RATIO, NUM_CONTEXTS, NUM_KINDS
from splatwire.codec.sequence.lifetimes import Lifetimes, read_lifetimes
from splatwire.errors import BitstreamError, MissingSideInfoError, UnsupportedVersionError
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.types.sequence_scene import Timeline

VERSION = 1
VERSION_WITH_SHOTS = 2
VERSION_WITH_MOTION_UNITS = 3
"""Versions of the side information: with one shot; with several shots; and with a unit of motion for each shot."""
MAX_LOG_STEP_RATIO = 16


@dataclass(frozen=True)
class GroupCounts:
    """Numbers of tracks (Gaussians over time) in a group of frames: new tracks, and tracks whose motion is coded.

    Attributes:
        num_births: Number of tracks that begin in the group, each with a keyframe Gaussian.
        num_motion_tracks: Number of tracks in the motion packets of the group.
    """

    num_births: int
    num_motion_tracks: int


@dataclass(frozen=True, eq=False)
class Shot:
    """Consecutive groups of frames whose keyframe Gaussians share a lattice, quantisation steps and tables.

    Attributes:
        first_group: Index of the first group.
        first_block: Index of the first block among all blocks of keyframe Gaussians.
        keyframe_info: Side information of the shot's keyframe Gaussians.
        log2_motion_unit: log2 of the unit of motion, relative to the unit in the first shot.
    """

    first_group: int
    first_block: int
    keyframe_info: KeyframeInfo
    log2_motion_unit: int = 0


@dataclass(frozen=True, eq=False)
class SequenceInfo:
    """Side information of a sequence: data shared by all packets.

    Attributes:
        timeline: Frame rate, number of frames, and number of frames per group.
        groups: Number of elements in each group of frames.
        shots: Side information of the keyframe Gaussians, one object per shot; a scene cut may begin a new shot.
        log_step_ratios: For each kind of channel (position, rotation, scale, opacity, colour), log2 of the ratio of the
            quantisation steps of motion to those of the keyframe Gaussian, int64 (kinds).
        zero_probabilities: Initial probability that a bit is 0, for each adaptive bit model of motion, out of 2**8,
            int64 (contexts).
        sections: Named sections, content by name.
        lifetimes: Lifetimes of tracks.
    """

    timeline: Timeline
    groups: tuple[GroupCounts, ...]
    shots: tuple[Shot, ...]
    log_step_ratios: np.ndarray
    zero_probabilities: np.ndarray
    sections: Mapping[str, bytes] = field(default_factory=dict)
    lifetimes: Lifetimes = field(default_factory=lambda: Lifetimes.joined([]))

    @property
    def keyframe_info(self) -> KeyframeInfo:
        """Side information of the keyframe Gaussians of the first group."""
        return self.shots[0].keyframe_info

    def shot_of(self, block: int) -> tuple[KeyframeInfo, int]:
        """Returns the side information that applies to a block of keyframe Gaussians.

        Args:
            block: Index of the block among all blocks of keyframe Gaussians.

        Returns:
            Side information of the block's shot, and the index of the block among the blocks of this shot.
        """
        shot = self._shot(block)
        return shot.keyframe_info, block - shot.first_block

    @property
    def log2_motion_units(self) -> np.ndarray:
        """Log2 of the ratio of each group's unit of motion to the first group's, int64 (groups)."""
        ends = [*(shot.first_group for shot in self.shots[1:]), len(self.groups)]
        counts = [end - shot.first_group for shot, end in zip(self.shots, ends, strict=True)]
        return np.repeat(np.array([shot.log2_motion_unit for shot in self.shots], np.int64), counts)

    def lattice_shift(self, block: int) -> int:
        """Returns log2 of half the lattice spacing of a block, relative to the unit of motion of its shot.

        The lattice contains the positions of the block's keyframe Gaussians.

        Args:
            block: Index of the block among all blocks of keyframe Gaussians.
        """
        shot = self._shot(block)
        return log2_lattice_ratio(shot.keyframe_info, self.keyframe_info) - shot.log2_motion_unit

    def _shot(self, block: int) -> Shot:
        return self.shots[bisect.bisect_right(self.shots, block, key=lambda shot: shot.first_block) - 1]

    def models(self) -> np.ndarray:
        """Returns the adaptive bit models in their state at the start of every motion packet, int64 (contexts, 2)."""
        return np.repeat(self.zero_probabilities[:, None] << 8, 2, axis=1)


def write_side_info(info: SequenceInfo) -> bytes:
    """Serialises the side information of a sequence."""
    clip, motion, timeline = ByteWriter(), ByteWriter(), info.timeline
    version = _version_of(info.shots)
    clip.u8(version)
    rate = timeline.rate
    for value in (rate.numerator, rate.denominator, timeline.num_frames, timeline.group_frames):
        clip.unsigned(value)
    for octaves in info.log_step_ratios.tolist():
        motion.signed(octaves)
    writer = ByteWriter()
    for part in (
        clip.bytes(),
        _write_shots(info.shots, version),
        motion.bytes() + bytes(info.zero_probabilities.astype(np.uint8)),
    ):
        writer.blob(part)
    return writer.bytes() + write_sections(info.sections)


def open_side_info(manifest: Manifest, side_info: bytes) -> SequenceInfo:
    """Reads side information serialised by `write_side_info`.

    Args:
        manifest: The stream's manifest.
        side_info: The side information, serialised.

    Raises:
        MissingSideInfoError: If the side information is empty.
        UnsupportedVersionError: If a newer release wrote the side information.
        BitstreamError: If the side information is damaged or contradicts the manifest.
    """
    if not side_info:
        raise MissingSideInfoError("the stream has no side information: no packet of it can be decoded")
    if not manifest.packetization.hashed:
        raise BitstreamError("packets of a clip are cut by their size, those of this manifest are not")
    reader = ByteReader(side_info, "side information")
    clip, shots_data, motion = (reader.blob() for _ in SCHEMAS[TRACKS].sections)
    (version, timeline), groups = _read_timeline(clip), _group_counts(manifest)
    if len(groups) != timeline.num_groups:
        raise BitstreamError(
            f"side information: {timeline.num_groups} groups of frames, the manifest has {len(groups)}"
        )
    log_step_ratios, zero_probabilities = _read_motion(motion)
    sections = read_sections(reader.rest())
    block_size = manifest.packetization.block_size
    first_blocks = np.cumsum([0, *(-(-group.num_births // block_size) for group in groups)]).tolist()
    shots = _read_shots(shots_data, version, first_blocks)
    lifetimes = read_lifetimes(sections, [group.num_births for group in groups], timeline)
    return SequenceInfo(timeline, groups, shots, log_step_ratios, zero_probabilities, sections, lifetimes)


def log2_lattice_ratio(info: KeyframeInfo, reference: KeyframeInfo) -> int:
    """Returns log2 of the ratio of the lattice spacing of `info` to the lattice spacing of `reference`."""
    return (info.size_log - info.lattice_bits) - (reference.size_log - reference.lattice_bits)


def _version_of(shots: Sequence[Shot]) -> int:
    """Returns the lowest version of the side information that can store the keyframe Gaussians of all shots.

    A shot is a range of groups of frames that share quantisation steps.
    """
    if any(shot.log2_motion_unit for shot in shots):
        return VERSION_WITH_MOTION_UNITS
    return VERSION if len(shots) == 1 else VERSION_WITH_SHOTS


def _write_shots(shots: Sequence[Shot], version: int) -> bytes:
    if version == VERSION:
        return write_keyframe_info(shots[0].keyframe_info)
    writer, before = ByteWriter(), 0
    writer.unsigned(len(shots))
    for shot in shots:
        writer.unsigned(shot.first_group - before)
        if version == VERSION_WITH_MOTION_UNITS:
            writer.signed(shot.log2_motion_unit)
        writer.blob(write_keyframe_info(shot.keyframe_info))
        before = shot.first_group
    return writer.bytes()


def _read_shots(data: bytes, version: int, first_blocks: Sequence[int]) -> tuple[Shot, ...]:
    """Reads the side information of the keyframe Gaussians, one part for each shot.

    A shot is a range of groups of frames that share a lattice, quantisation steps and probability tables.

    Args:
        data: Serialised side information of all shots. For each shot, it contains the first group of frames, the unit
            of motion, and the side information of the keyframe Gaussians.
        version: Version of the side information: `VERSION` for a single shot; `VERSION_WITH_SHOTS` for several shots
            with the same unit of motion; `VERSION_WITH_MOTION_UNITS` for shots with different units.
        first_blocks: Index of the first block of keyframe Gaussians of each group, then the number of all blocks.
    """
    if version == VERSION:
        return (Shot(0, 0, read_keyframe_info(data, first_blocks[-1])),)
    reader, num_groups = ByteReader(data, "side information of shots"), len(first_blocks) - 1
    first_groups, log2_units, parts = list[int](), list[int](), list[bytes]()
    for _ in range(reader.unsigned()):
        first_groups.append(reader.unsigned() + (first_groups[-1] if first_groups else 0))
        log2_units.append(reader.signed() if version == VERSION_WITH_MOTION_UNITS else 0)
        parts.append(reader.blob())
    reader.finish()
    if first_groups[:1] != [0] or any(a >= b for a, b in itertools.pairwise([*first_groups, num_groups])):
        raise BitstreamError(f"side information: {len(first_groups)} shots do not divide {num_groups} groups of frames")
    end_blocks = [first_blocks[group] for group in [*first_groups[1:], num_groups]]
    shots = tuple(
        Shot(group, first_blocks[group], read_keyframe_info(part, end - first_blocks[group]), log2_unit)
        for group, part, end, log2_unit in zip(first_groups, parts, end_blocks, log2_units, strict=True)
    )
    for number, shot in enumerate(shots):
        _check_shot(number, shot, shots[0].keyframe_info)
    return shots


def _check_shot(number: int, shot: Shot, reference: KeyframeInfo) -> None:
    info = shot.keyframe_info
    if info.degree != reference.degree:
        raise BitstreamError(
            f"side information: shot {number} has harmonics of degree {info.degree}, the first one {reference.degree}"
        )
    ratio, log2_unit = log2_lattice_ratio(info, reference), shot.log2_motion_unit
    if abs(ratio) > MAX_LOG2_RATIO:
        raise BitstreamError(f"side information: the lattice of shot {number} is too unlike that of the first one")
    if max(abs(log2_unit), abs(ratio - log2_unit)) > MAX_LOG2_RATIO:
        raise BitstreamError(f"side information: the unit of motion of shot {number} is out of range")


def _group_counts(manifest: Manifest) -> tuple[GroupCounts, ...]:
    """Returns the numbers of new tracks and of tracks with coded motion in each group of frames, from the manifest."""
    counts = [tier.num_elements for tier in manifest.tiers]
    groups, alive = tuple(itertools.starmap(GroupCounts, zip(counts[::2], counts[1::2], strict=True))), 0
    for group in groups:
        alive += group.num_births
        if group.num_motion_tracks > alive:
            raise BitstreamError(f"{group.num_motion_tracks} tracks move in a group where {alive} are born")
    return groups


def _read_timeline(data: bytes) -> tuple[int, Timeline]:
    """Reads the version of the side information, and the timeline."""
    reader = ByteReader(data, "side information of the clip")
    version = reader.u8()
    if version not in (VERSION, VERSION_WITH_SHOTS, VERSION_WITH_MOTION_UNITS):
        raise UnsupportedVersionError(
            f"side information has version {version}, this release reads versions {VERSION} to "
            f"{VERSION_WITH_MOTION_UNITS}"
        )
    numerator, denominator, num_frames, group_frames = (reader.unsigned() for _ in range(4))
    possible = 0 < denominator <= MAX_FRAMES and 0 < numerator <= MAX_FRAME_RATE * denominator
    if not (possible and 0 < num_frames <= MAX_FRAMES and 0 < group_frames <= MAX_GROUP_FRAMES):
        raise BitstreamError(
            f"side information: {num_frames} frames in groups of {group_frames} at {numerator}/{denominator} are "
            "impossible"
        )
    reader.finish()
    return version, Timeline(Fraction(numerator, denominator), num_frames, group_frames)


def _read_motion(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    reader = ByteReader(data, "side information of motion")
    log_step_ratios = np.array([reader.signed() for _ in range(NUM_KINDS)], dtype=np.int64)
    if np.abs(log_step_ratios).max() > MAX_LOG_STEP_RATIO:
        raise BitstreamError(f"side information: impossible steps of motion {log_step_ratios.tolist()}")
    zero_probabilities = np.frombuffer(reader.take(NUM_CONTEXTS), np.uint8).astype(np.int64)
    reader.finish()
    return log_step_ratios, np.clip(zero_probabilities, 1, 255)
