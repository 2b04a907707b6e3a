"""Poses of tracks within a group of pictures (GOP), and the concealment state at the end of the group."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from splatwire.types.sequence_scene import SequenceScene


@dataclass(frozen=True, eq=False)
class GroupPoses:
    """Poses of all drawn tracks in each frame of a group of pictures.

    Attributes:
        tracks: Track indices, ascending, int64 (n).
        begins: First frame of each track, counted from the start of the group, int64 (n).
        ends: Frame after the last frame of each track, counted from the start of the group, int64 (n).
        concealed: Mask of tracks with lost motion, bool (n).
        at: Function that returns the offset of each track from its keyframe Gaussian in a frame of the group, float32
            (n, C); channels as in `GroupMotion.at`.
    """

    tracks: np.ndarray
    begins: np.ndarray
    ends: np.ndarray
    concealed: np.ndarray
    at: Callable[[int], np.ndarray]

    def only(self, rows: np.ndarray) -> "GroupPoses":
        """Returns the poses of some of the n tracks.

        Args:
            rows: Mask of the tracks to return, bool (n).
        """
        if rows.all():
            return self
        tracks, begins, ends, concealed = (v[rows] for v in (self.tracks, self.begins, self.ends, self.concealed))
        return GroupPoses(tracks, begins, ends, concealed, lambda frame: self.at(frame)[rows])


@dataclass(frozen=True, eq=False)
class ConcealmentState:
    """Concealment state at the end of a group of pictures: last offsets and velocities of all T tracks.

    Attributes:
        alive: Mask of tracks that exist at the end of the group, bool (T).
        offsets: State of each track in the last frame of the group, as difference from its keyframe Gaussian, float32
            (T, C).
        velocity: Change of the offsets since the previous frame, float32 (T, C).
        concealed: Mask of tracks with estimated motion, bool (T).
    """

    alive: np.ndarray
    offsets: np.ndarray
    velocity: np.ndarray
    concealed: np.ndarray

    def extended_to(self, num_tracks: int) -> "ConcealmentState":
        """Returns the state extended to `num_tracks` tracks; added tracks do not exist yet."""
        more = num_tracks - len(self.alive)
        if not more:
            return self
        return ConcealmentState(**{
            name: np.concatenate([values, np.zeros((more, *values.shape[1:]), values.dtype)])
            for name, values in vars(self).items()
        })  # fmt: skip


def lifetimes(sequence: SequenceScene, group: int, lost_tracks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the first frame and the end of each track with lost motion within one group of pictures.

    Args:
        sequence: The sequence.
        group: Index of the group of pictures.
        lost_tracks: Indices of the n tracks.

    Returns:
        First frame of each track; and the frame after the last frame of each track, int64 (n) each. Frames are counted
        from the start of the group.
    """
    frames, tracks = sequence.timeline.frames_of(group), sequence.tracks
    begins = np.where(tracks.born[lost_tracks] == group, tracks.begins[lost_tracks], 0)
    return np.minimum(begins, len(frames) - 1), np.minimum(tracks.ends[lost_tracks] - frames.start, len(frames))
