"""Lifetimes of tracks (Gaussians over time) in the side information, which does not get lost (docs/format.md)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from splatwire.errors import BitstreamError
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.types.sequence_scene import Timeline

SECTION = "lifetimes"
PACKET_BYTES_PER_LIFETIME = 512
"""Limit on the section of lifetimes: at most one entry for each of this number of bytes in a group's packets. An entry
takes two or three bytes, so the section adds about one byte per 200.
"""


@dataclass(frozen=True, eq=False)
class Lifetimes:
    """Lifetimes of tracks (Gaussians over time), stored as exceptions: tracks that begin late or end early.

    All other tracks are treated as if they existed from the first frame of their group to the end of the sequence: an
    encoder may leave out those that are hardly visible.

    Attributes:
        begin_tracks: Indices of tracks that begin after the first frame of their group, ascending, int64 (m).
        begin_frames: First frame of each track in `begin_tracks`, counted from the start of the group in which the
            track begins, int64 (m).
        end_tracks: Indices of tracks that end before the sequence does, ascending, int64 (k).
        end_frames: First frame after the end of each track in `end_tracks`, counted from the start of the sequence,
            int64 (k).
    """

    begin_tracks: np.ndarray
    begin_frames: np.ndarray
    end_tracks: np.ndarray
    end_frames: np.ndarray

    @staticmethod
    def joined(parts: Sequence["Lifetimes"]) -> "Lifetimes":
        """Merges the lifetimes of several groups of frames."""
        names = ("begin_tracks", "begin_frames", "end_tracks", "end_frames")
        values = {name: np.concatenate([np.zeros(0, np.int64), *(getattr(p, name) for p in parts)]) for name in names}
        begin, end = np.argsort(values["begin_tracks"]), np.argsort(values["end_tracks"])
        return Lifetimes(*(values[name][order] for name, order in zip(names, (begin, begin, end, end), strict=True)))

    def with_ended(self, tracks: np.ndarray, frame: int) -> "Lifetimes":
        """Returns the lifetimes with entries added for tracks that end at a given frame.

        Args:
            tracks: Indices of the tracks, int64.
            frame: First frame after the end of the tracks, counted from the start of the sequence.
        """
        gone = Lifetimes(tracks[:0], tracks[:0], tracks, np.full(len(tracks), frame))
        return Lifetimes.joined([self, gone])

    def by_track(self, num_tracks: int, num_frames: int) -> tuple[np.ndarray, np.ndarray]:
        """Returns the frame in which each track (Gaussian over time) begins, and the frame after its last frame.

        Args:
            num_tracks: Number of tracks, T.
            num_frames: Number of frames in the sequence.

        Returns:
            Two arrays, int64 (T) each. The first has the first frame of each track, counted from the start of the group
            in which the track begins. The second has the frame after the last frame of each track, counted from the
            start of the sequence.
        """
        begins, ends = np.zeros(num_tracks, np.int64), np.full(num_tracks, num_frames)
        begins[self.begin_tracks], ends[self.end_tracks] = self.begin_frames, self.end_frames
        return begins, ends

    def without_least_visible(self, visibility: np.ndarray, max_tracks: int) -> "Lifetimes":
        """Returns the lifetimes without the entries of the least visible tracks, which saves bytes.

        Tracks without an entry are treated as if they existed from the first frame of their group to the end of the
        sequence.

        Args:
            visibility: Visibility of each track (squared opacity times area), float64 (T).
            max_tracks: Maximum number of tracks that keep their entries.
        """
        listed_tracks = np.union1d(self.begin_tracks, self.end_tracks)
        keep = listed_tracks[np.argsort(-visibility[listed_tracks], kind="stable")[:max_tracks]]
        begin, end = np.isin(self.begin_tracks, keep), np.isin(self.end_tracks, keep)
        return Lifetimes(self.begin_tracks[begin], self.begin_frames[begin], self.end_tracks[end], self.end_frames[end])


def lifetimes_sections(lifetimes: Lifetimes) -> dict[str, bytes]:
    """Serialises lifetimes of tracks as a named section of the side information."""
    if not len(lifetimes.begin_tracks) + len(lifetimes.end_tracks):
        return {}
    writer = ByteWriter()
    for tracks, frames in (
        (lifetimes.begin_tracks, lifetimes.begin_frames),
        (lifetimes.end_tracks, lifetimes.end_frames),
    ):
        writer.unsigned(len(tracks))
        for gap, frame in zip((np.diff(tracks, prepend=-1) - 1).tolist(), frames.tolist(), strict=True):
            writer.unsigned(gap)
            writer.unsigned(frame)
    return {SECTION: writer.bytes()}


def read_lifetimes(sections: Mapping[str, bytes], births: Sequence[int], timeline: Timeline) -> Lifetimes:
    """Reads lifetimes of tracks from a named section of the side information.

    Args:
        sections: Named sections of the stream, content by name.
        births: Number of new tracks in each group of frames.
        timeline: Timeline of the sequence.

    Raises:
        BitstreamError: If the section is damaged.
    """
    if SECTION not in sections:
        return Lifetimes.joined([])
    reader, count = ByteReader(sections[SECTION], f"section '{SECTION}'"), sum(births)
    values = []
    for _ in range(2):
        track, pairs = -1, []
        for _ in range(reader.unsigned()):
            track += reader.unsigned() + 1
            pairs.append((track, reader.unsigned()))
            if track >= count or pairs[-1][1] > timeline.num_frames:
                raise BitstreamError(f"section '{SECTION}': track {track}, frame {pairs[-1][1]} are not in the clip")
        values += list(np.array(pairs, np.int64).reshape(-1, 2).T)
    reader.finish()
    lifetimes = Lifetimes(*values)
    listed_tracks = np.union1d(lifetimes.begin_tracks, lifetimes.end_tracks)
    begin, end = (np.searchsorted(listed_tracks, tracks) for tracks in (lifetimes.begin_tracks, lifetimes.end_tracks))
    lifetimes_of_listed = Lifetimes(begin, lifetimes.begin_frames, end, lifetimes.end_frames)
    begins, ends = lifetimes_of_listed.by_track(len(listed_tracks), timeline.num_frames)
    first = np.searchsorted(np.cumsum(births), listed_tracks, side="right") * timeline.group_frames
    if (begins >= timeline.group_frames).any() or (first + begins >= ends).any():
        raise BitstreamError(f"section '{SECTION}': a track ends before it begins")
    return lifetimes
