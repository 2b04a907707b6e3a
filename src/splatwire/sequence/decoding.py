"""Decoder of sequences, one group of pictures (GOP) at a time."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from splatwire.arguments import CheckedFields, checked
from splatwire.bitstream import Manifest, Packet
from splatwire.codec import ProgressiveDecoder
from splatwire.codec.memory import check_memory
from splatwire.concealment import conceal
from splatwire.concealment.temporal.concealers import DEFAULT, TemporalConcealer, temporal_concealer
from splatwire.concealment.temporal.concealment import conceal_group
from splatwire.concealment.temporal.neighbors import POSITION
from splatwire.concealment.temporal.poses import ConcealmentState, GroupPoses
from splatwire.errors import BitstreamError
from splatwire.ops.threads import parallel_map
from splatwire.reprs import summary_repr
from splatwire.sequence import _pose_kernels as kernels
from splatwire.types import LossMask, ReceivedScene, RenderHints, SplatScene
from splatwire.types.sequence_scene import SequenceScene
from splatwire.types.splats import Splats

MOVE_BATCH = 1 << 13
"""Number of Gaussians that a thread moves at a time."""


@dataclass(frozen=True, eq=False)
class SequenceFrame(CheckedFields):
    """Decoded and concealed frame of a sequence.

    Attributes:
        number: Number of the frame in the sequence, from 0.
        scene: Visible Gaussians.
        tracks: Track index of each Gaussian, int64 (M).
        concealed: Mask of Gaussians whose motion was lost and concealed, bool (M).
    """

    number: int
    scene: SplatScene
    tracks: np.ndarray
    concealed: np.ndarray

    __repr__ = summary_repr


@checked
def decode_frames(
    sequence: SequenceScene,
    concealer: TemporalConcealer | str = DEFAULT,
    *,
    first: int = 0,
    available: Callable[[int], np.ndarray] | None = None,
) -> Iterator[SequenceFrame]:
    """Decodes and yields the frames of a sequence in order.

    Args:
        sequence: Received sequence.
        concealer: Concealer for tracks with lost motion, or the name of a concealer.
        first: Number of the first frame to decode.
        available: Function that takes the index of a group of pictures, and returns the mask of keyframe Gaussians
            that may be used for the group, bool (T). None to use all received keyframe Gaussians.

    Raises:
        InvalidValueError: If the sequence has no such frame.
        UnknownNameError: If the concealer is unknown.
    """
    method = temporal_concealer(concealer) if isinstance(concealer, str) else concealer
    begin = sequence.timeline.group_of(first)
    concealment_state: ConcealmentState | None = None
    for group in range(begin, sequence.timeline.num_groups):
        received = sequence.tracks.received if available is None else sequence.tracks.received & available(group)
        frames, state_after = decode_group(sequence, group, received, concealment_state, method)
        yield from (frame for frame in frames if frame.number >= first)
        concealment_state = state_after()


def decode_group(
    sequence: SequenceScene,
    group: int,
    available: np.ndarray,
    concealment_state: ConcealmentState | None,
    method: TemporalConcealer,
) -> tuple[Iterator[SequenceFrame], Callable[[], ConcealmentState]]:
    """Decodes one group of pictures (GOP) of a sequence.

    Args:
        sequence: Received sequence.
        group: Index of the group of pictures.
        available: Mask of available keyframe Gaussians, bool (T).
        concealment_state: State of the loss concealment after the previous group; None if the previous group was not
            decoded.
        method: Concealer for tracks with lost motion.

    Returns:
        Two items: an iterator that decodes the frames of the group; and a function that returns the state of the loss
        concealment after these frames, as input for the next group.
    """
    poses, hidden, state_after = conceal_group(
        sequence, sequence.motion(group, available), group, available, concealment_state, method
    )
    hints = covering_gains(sequence, available, group, poses, hidden) if method.grow else None
    numbers = enumerate(sequence.timeline.frames_of(group))
    return (pose_frame(sequence, poses, index, number, hints) for index, number in numbers), state_after


@checked
def decode_frame(sequence: SequenceScene, number: int, concealer: TemporalConcealer | str = DEFAULT) -> SequenceFrame:
    """Decodes a single frame. Losses are concealed without the frames of earlier groups of pictures.

    Args:
        sequence: Received sequence.
        number: Number of the frame, from 0.
        concealer: Concealer for tracks with lost motion, or the name of a concealer.

    Raises:
        InvalidValueError: If the sequence has no such frame.
        UnknownNameError: If the concealer is unknown.
    """
    return next(decode_frames(sequence, concealer, first=number))


class SequenceDecoder:
    """Decoder of a sequence that accepts packets in any order and decodes frames at any time.

    Args:
        manifest: Manifest of the stream.
        side_info: Side information of the stream (data that all packets need).
        concealer: Concealer for tracks with lost motion, or the name of a concealer.

    Raises:
        BitstreamError: If the side information contradicts the manifest, or the stream is not a sequence.
        UnknownNameError: If the concealer is unknown.
    """

    @checked
    def __init__(self, manifest: Manifest, side_info: bytes, concealer: TemporalConcealer | str = DEFAULT) -> None:
        if not manifest.schema.timed:
            raise BitstreamError(f"a stream of {manifest.elements} is a scene, not a clip")
        self._concealer = temporal_concealer(concealer) if isinstance(concealer, str) else concealer
        self._decoder = ProgressiveDecoder(manifest, side_info)

    @property
    def complete(self) -> bool:
        """True if every packet has been received."""
        return self._decoder.complete

    def push(self, packet: Packet) -> None:
        """Adds a packet; ignores duplicates and packets that the manifest does not list.

        Raises:
            DesyncError: If all packets are received but the decoded integers differ from the encoded ones.
        """
        self._decoder.add([packet])

    def frame(self, number: int) -> SequenceFrame:
        """Decodes a frame of a sequence from the packets received so far.

        Raises:
            InvalidValueError: If the sequence has no such frame.
            BitstreamError: If the tracks declared in the manifest need more memory than the received bytes justify.
        """
        check_memory(self._decoder.scene_bytes, self._decoder.num_bytes, "a frame of all tracks that are announced")
        return decode_frame(self._decoder.received_scene.scene, number, self._concealer)


def pose_frame(
    sequence: SequenceScene, poses: GroupPoses, index: int, number: int, hints: RenderHints | None
) -> SequenceFrame:
    """Builds one frame of a sequence: the Gaussians of the tracks that exist in the frame, with their motion applied.

    A track is one Gaussian over time.

    Args:
        sequence: Received sequence.
        poses: Motion of the tracks in the group.
        index: Frame index within the group.
        number: Frame number within the sequence.
        hints: Factors on size and opacity of all tracks, so that the drawn tracks cover missing ones; None if nothing
            is missing.
    """
    drawn = np.flatnonzero((poses.begins <= index) & (index < poses.ends))
    tracks = poses.tracks[drawn]
    offsets = poses.at(index)
    splats = apply_motion(sequence.tracks.splats, tracks, offsets if len(drawn) == len(offsets) else offsets[drawn])
    scene = SplatScene(
        splats,
        background=sequence.background,
        antialiased=sequence.antialiased,
        origin=sequence.origin,
        metadata=sequence.metadata,
    )
    if hints is not None:
        opacity = None if hints.opacity_gain is None else hints.opacity_gain[tracks]
        frame_hints = RenderHints(hints.size_gain[tracks], np.zeros(len(tracks), np.bool_), opacity)
        scene = replace(scene, splats=SplatScene(splats, frame_hints).drawn())
    return SequenceFrame(number, scene, tracks, poses.concealed[drawn])


def apply_motion(splats: Splats, tracks: np.ndarray, offsets: np.ndarray) -> Splats:
    """Computes the Gaussians of tracks in one frame: keyframe Gaussians moved by decoded motion.

    A track is one Gaussian over time. Its motion is coded relative to its keyframe Gaussian.

    Args:
        splats: Keyframe Gaussians of all tracks.
        tracks: Indices of the n tracks in `splats`, int64 (n).
        offsets: Changes of the n tracks relative to their keyframe Gaussians, float32 (n, C); see `GroupMotion.at`.
    """
    moved = Splats.empty(len(tracks), splats.degree)
    keyframes, offsets, whole = _arrays(splats), np.ascontiguousarray(offsets), _arrays(moved)

    def move(rows: slice) -> None:
        kernels.move(keyframes, tracks[rows], offsets[rows], tuple(values[rows] for values in whole))

    parallel_map(move, [slice(begin, begin + MOVE_BATCH) for begin in range(0, len(tracks), MOVE_BATCH)])
    return moved


def _arrays(splats: Splats) -> tuple[np.ndarray, ...]:
    """Returns means, quaternions, scales, opacities and harmonics of Gaussians as contiguous arrays."""
    means, quats, scales, opacities, sh = (np.ascontiguousarray(values) for values in vars(splats).values())
    return means, quats, scales, opacities, sh.reshape(len(sh), 3 * sh.shape[1])


def covering_gains(
    sequence: SequenceScene, available: np.ndarray, group: int, poses: GroupPoses, hidden: GroupPoses
) -> RenderHints | None:
    """Computes factors that enlarge the received Gaussians of a group of pictures, so that they cover missing ones.

    Args:
        sequence: Received sequence of T tracks.
        available: Mask of received keyframe Gaussians, bool (T).
        group: Index of the group of pictures.
        poses: Motion of the drawn tracks in the group. A track is one Gaussian over time.
        hidden: Estimated motion of the other tracks, which are not drawn because their motion was lost.

    Returns:
        Factors on size and opacity of all tracks; None if nothing is missing.
    """
    # Missing are tracks whose keyframe packet was lost, or which the concealer hides. Gaussians that appear in later
    # groups do not count.
    splats, begun_tracks = sequence.tracks.splats, np.flatnonzero(sequence.tracks.born <= group)
    if bool(available[begun_tracks].all()) and not len(hidden.tracks):
        return None
    size, opacity = _growth_factors(splats, begun_tracks, available)
    if len(hidden.tracks):
        means, is_drawn = splats.means.copy(), np.ones(sequence.num_gaussians, bool)
        is_drawn[hidden.tracks] = False
        for motion in (poses, hidden):
            means[motion.tracks] += motion.at(0)[:, POSITION]
        growth = _growth_factors(replace(splats, means=means), np.union1d(poses.tracks, hidden.tracks), is_drawn)
        size, opacity = size * growth[0], opacity * growth[1]
    return RenderHints(size, np.zeros(sequence.num_gaussians, np.bool_), opacity)


def _growth_factors(splats: Splats, index: np.ndarray, received_mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Computes the factors by which received Gaussians are enlarged to cover missing ones.

    Args:
        splats: All T Gaussians.
        index: Indices of the Gaussians that would be visible without losses, ascending, int64.
        received_mask: Mask of received Gaussians, bool (T).

    Returns:
        Factors on the size and factors on the opacity of each Gaussian, float32 (T) each; 1 for no change.
    """
    size, opacity = np.ones((2, splats.num_gaussians), np.float32)
    scene = conceal(ReceivedScene(SplatScene(splats.select(index)), LossMask.of_elements(received_mask[index])), "grow")
    hints: RenderHints | None = scene.hints
    if hints is not None:
        size[index] = hints.size_gain
        if hints.opacity_gain is not None:
            opacity[index] = hints.opacity_gain
    return size, opacity
