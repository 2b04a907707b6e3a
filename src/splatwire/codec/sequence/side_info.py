"""Side information of a sequence, sent before the packets (docs/format.md).

It contains the timeline, the numbers of new and of moving tracks in each group of frames, the quantisation steps and
the context tables.
"""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from splatwire.bitstream import Manifest
from splatwire.bitstream.limits import MAX_FRAME_RATE, MAX_FRAMES, MAX_GROUP_FRAMES, SCHEMAS, TRACKS
from splatwire.bitstream.sections import read_sections, write_sections
from splatwire.codec.gaussians.side_info import SideInfo as KeyframeInfo
from splatwire.codec.gaussians.side_info import read_side_info as read_keyframes
from splatwire.codec.gaussians.side_info import write_side_info as write_keyframes
from splatwire.codec.sequence.layout import NUM_CONTEXTS, NUM_KINDS
from splatwire.codec.sequence.lifetimes import Lifetimes, read_lifetimes
from splatwire.errors import BitstreamError, MissingSideInfoError, UnsupportedVersionError
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.types.sequence_scene import Timeline

VERSION = 1
MAX_OFFSET = 16


@dataclass(frozen=True)
class Group:
    """Numbers of new tracks and of tracks with motion in a group of pictures.

    Attributes:
        births: Number of tracks that begin in the group, and thus of keyframe Gaussians.
        motions: Number of tracks in the motion packets of the group; 0 if all tracks stay unchanged.
    """

    births: int
    motions: int


@dataclass(frozen=True, eq=False)
class SequenceInfo:
    """Side information of a sequence: data shared by all packets.

    Attributes:
        timeline: Frame rate, number of frames, and number of frames per group.
        groups: Number of elements in each group of frames.
        keyframes: Side information of the keyframe Gaussians, with one bounding box for each block of keyframe
            Gaussians of the packet plan.
        coarser: Octaves by which the quantisation steps of motion are coarser than those of the keyframe Gaussian, by
            kind of channel (`layout.KINDS`), int64 (kinds).
        bit_zero: Initial probability of a zero for each adaptive bit model of motion, out of 2**8, int64 (contexts).
        sections: Named sections, content by name.
        lifetimes: Lifetimes of tracks, read from the section of that name.
    """

    timeline: Timeline
    groups: tuple[Group, ...]
    keyframes: KeyframeInfo
    coarser: np.ndarray
    bit_zero: np.ndarray
    sections: Mapping[str, bytes] = field(default_factory=dict)
    lifetimes: Lifetimes = field(default_factory=lambda: Lifetimes.joined([]))

    def models(self) -> np.ndarray:
        """Returns the adaptive bit models in their state at the start of every motion packet, int64 (contexts, 2)."""
        return np.repeat(self.bit_zero[:, None] << 8, 2, axis=1)


def write_side_info(info: SequenceInfo) -> bytes:
    """Serialises the side information of a sequence."""
    clip, motion, time = ByteWriter(), ByteWriter(), info.timeline
    clip.u8(VERSION)
    for value in (time.rate.numerator, time.rate.denominator, time.num_frames, time.group_frames):
        clip.unsigned(value)
    for octaves in info.coarser.tolist():
        motion.signed(octaves)
    writer = ByteWriter()
    for part in (
        clip.bytes(),
        write_keyframes(info.keyframes),
        motion.bytes() + bytes(info.bit_zero.astype(np.uint8)),
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
    clip, keyframes, motion = (reader.blob() for _ in SCHEMAS[TRACKS].sections)
    timeline, groups = _read_timeline(clip), _groups(manifest)
    if len(groups) != timeline.num_groups:
        raise BitstreamError(
            f"side information: {timeline.num_groups} groups of frames, the manifest has {len(groups)}"
        )
    coarser, bit_zero = _read_motion(motion)
    sections = read_sections(reader.rest())
    size = manifest.packetization.block_size
    base = read_keyframes(keyframes, sum(-(-group.births // size) for group in groups))
    lifetimes = read_lifetimes(sections, [group.births for group in groups], timeline)
    return SequenceInfo(timeline, groups, base, coarser, bit_zero, sections, lifetimes)


def _groups(manifest: Manifest) -> tuple[Group, ...]:
    """Returns the number of elements in each group of frames, from the tiers of the manifest."""
    counts = [tier.num_elements for tier in manifest.tiers]
    groups, alive = tuple(itertools.starmap(Group, zip(counts[::2], counts[1::2], strict=True))), 0
    for group in groups:
        alive += group.births
        if group.motions > alive:
            raise BitstreamError(f"{group.motions} tracks move in a group where {alive} are born")
    return groups


def _read_timeline(data: bytes) -> Timeline:
    reader = ByteReader(data, "side information of the clip")
    version = reader.u8()
    if version != VERSION:
        raise UnsupportedVersionError(f"side information has version {version}, this release reads version {VERSION}")
    numerator, denominator, frames, size = (reader.unsigned() for _ in range(4))
    possible = 0 < denominator <= MAX_FRAMES and 0 < numerator <= MAX_FRAME_RATE * denominator
    if not (possible and 0 < frames <= MAX_FRAMES and 0 < size <= MAX_GROUP_FRAMES):
        raise BitstreamError(
            f"side information: {frames} frames in groups of {size} at {numerator}/{denominator} are impossible"
        )
    reader.finish()
    return Timeline(Fraction(numerator, denominator), frames, size)


def _read_motion(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    reader = ByteReader(data, "side information of motion")
    coarser = np.array([reader.signed() for _ in range(NUM_KINDS)], dtype=np.int64)
    if np.abs(coarser).max() > MAX_OFFSET:
        raise BitstreamError(f"side information: impossible steps of motion {coarser.tolist()}")
    zero = np.frombuffer(reader.take(NUM_CONTEXTS), np.uint8).astype(np.int64)
    reader.finish()
    return coarser, np.clip(zero, 1, 255)
