"""Tracks (Gaussians over time) that an encoder has encoded so far."""

from dataclasses import dataclass

import numpy as np

from splatwire.codec.sequence.layout import NUM_CHANNELS
from splatwire.codec.sequence.steps import in_other_units
from splatwire.codec.sequence.track_group import TrackGroup
from splatwire.codec.sequence.trajectories import Trajectories
from splatwire.types.splats import Splats


@dataclass(frozen=True, eq=False)
class KnownTracks:
    """Tracks (Gaussians over time) of a sequence that were encoded so far, in order of appearance.

    Attributes:
        keys: Key of each track, an integer by which the application identifies the track, int64 (T).
        by_key: Entry i is the index of the track with the i-th smallest key, int64 (T).
        source_keyframes: Keyframe Gaussian of each track before quantisation, as trajectories of one frame.
        positions: Decoded position of each keyframe Gaussian, int64 (T, 3), in the unit of motion of the shot in
            which it was encoded. A shot is a range of groups of frames that share a lattice, steps and tables.
        shifts: log2 of the quantisation steps of each track's motion, by channel, int64 (T, channels).
        log2_units: For each track, log2 of the ratio of the unit of its position to the unit of the first shot, int64
            (T).
        visibility: Visibility of each track (squared opacity times area), float64 (T).
        alive: Indices of the tracks present at the end of the last group, ascending, int64.
    """

    keys: np.ndarray
    by_key: np.ndarray
    source_keyframes: Trajectories
    positions: np.ndarray
    shifts: np.ndarray
    log2_units: np.ndarray
    visibility: np.ndarray
    alive: np.ndarray

    @staticmethod
    def empty() -> "KnownTracks":
        """Returns a collection without tracks, the state of an encoder before the first group of frames."""
        empty = Trajectories(*(np.zeros((0, 1, *shape), np.float32) for shape in ((3,), (4,), (3,), (), (3,))))
        none = np.zeros(0, np.int64)
        positions, shifts = (np.zeros((0, count), np.int64) for count in (3, NUM_CHANNELS))
        return KnownTracks(none, none, empty, positions, shifts, none, np.zeros(0), none)

    def indices_of(self, keys: np.ndarray) -> np.ndarray:
        """Returns the track index for each key, int64; -1 for unknown keys."""
        if not len(self.keys):
            return np.full(len(keys), -1, np.int64)
        sorted_keys = self.keys[self.by_key]
        # Of several tracks with the same key, the latest.
        index = np.maximum(np.searchsorted(sorted_keys, keys, side="right") - 1, 0)
        return np.where(sorted_keys[index] == keys, self.by_key[index], -1)

    def in_units(self, tracks: np.ndarray | slice, log2_unit: int) -> tuple[np.ndarray, np.ndarray]:
        """Converts tracks of different shots, whose positions have different units, to one common unit.

        Args:
            tracks: Indices of the tracks.
            log2_unit: log2 of the common unit, where the unit of the first shot is 1.

        Returns:
            Positions of the n tracks, int64 (n, 3); and log2 of the quantisation steps of their motion, int64 (n,
            channels).
        """
        return in_other_units(self.positions[tracks], self.shifts[tracks], self.log2_units[tracks] - log2_unit)

    def empty_group(self, num_frames: int) -> TrackGroup:
        """Returns a group of frames without visible Gaussians.

        The group has one track, which exists in none of the frames. A group without tracks would mean that all tracks
        stay unchanged.

        Args:
            num_frames: Number of frames in the group.
        """
        one, none = self.alive[-1:], np.zeros(1, np.int64)
        poses = {
            name: np.repeat(values[one], num_frames, axis=1) for name, values in vars(self.source_keyframes).items()
        }
        return TrackGroup(self.keys[one], none, none, Trajectories(**poses), _no_births)

    def with_births(
        self, keyframes: Trajectories, keys: np.ndarray, positions: np.ndarray, shifts: np.ndarray, log2_unit: int
    ) -> "KnownTracks":
        """Returns these tracks (Gaussians over time) with new tracks appended.

        Args:
            keyframes: Keyframe Gaussians of the n new tracks before quantisation, as trajectories of one frame.
            keys: Keys (identifiers) of the new tracks, int64 (n).
            positions: Decoded positions of the keyframe Gaussians, int64 (n, 3).
            shifts: log2 of the quantisation steps of the new tracks' motion, int64 (n, channels).
            log2_unit: log2 of the ratio of the unit of `positions` to the unit of the first shot. A shot is a range of
                groups of frames that share a lattice, quantisation steps and tables.
        """
        source_keyframes = {
            name: np.concatenate([old, getattr(keyframes, name)]) for name, old in vars(self.source_keyframes).items()
        }
        all_keys = np.concatenate([self.keys, keys])
        return KnownTracks(
            all_keys,
            np.argsort(all_keys, kind="stable"),
            Trajectories(**source_keyframes),
            np.concatenate([self.positions, positions]),
            np.concatenate([self.shifts, shifts]),
            np.concatenate([self.log2_units, np.full(len(keys), log2_unit, np.int64)]),
            np.concatenate([self.visibility, visibility_of(keyframes.scales[:, 0], keyframes.opacities[:, 0])]),
            self.alive,
        )


def _no_births(_: np.ndarray) -> Splats:
    raise AssertionError("no track begins in a group without tracks")


def visibility_of(scales: np.ndarray, opacities: np.ndarray) -> np.ndarray:
    """Returns the visibility of Gaussians: squared opacity times the product of the two largest scales, float64 (T).

    Args:
        scales: Scales of the Gaussians, (T, 3).
        opacities: Opacities of the Gaussians, (T).
    """
    sorted_scales = np.sort(scales.astype(np.float64), axis=1)
    visibility: np.ndarray = sorted_scales[:, 1] * sorted_scales[:, 2] * opacities.astype(np.float64) ** 2
    return visibility
