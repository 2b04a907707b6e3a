"""When tracks come and go: a named section, so that it is not lost with the motion of a group (docs/format.md)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from splatwire.byte_io import ByteReader, ByteWriter
from splatwire.errors import BitstreamError
from splatwire.model.clip import Timeline

SECTION = "lifetimes"
BYTES_OF_ONE = 512
"""Of a group's packets, for each track that is told about: two or three bytes each, about one in 200."""


@dataclass(frozen=True, eq=False)
class Lifetimes:
    """Tracks that are not there from the first frame of the group that they are born in, and tracks that end.

    Attributes:
        late: Those that come late, ascending, int64 (m).
        begins: First frame of each, counted from that of the group that it is born in, int64 (m).
        early: Those that end before the clip does, ascending, int64 (k).
        ends: First frame of the clip after each, int64 (k).
    """

    late: np.ndarray
    begins: np.ndarray
    early: np.ndarray
    ends: np.ndarray

    @staticmethod
    def joined(parts: Sequence["Lifetimes"]) -> "Lifetimes":
        """Those of all groups; each track comes once and ends once."""
        names = ("late", "begins", "early", "ends")
        values = {name: np.concatenate([np.zeros(0, np.int64), *(getattr(p, name) for p in parts)]) for name in names}
        late, early = np.argsort(values["late"]), np.argsort(values["early"])
        return Lifetimes(values["late"][late], values["begins"][late], values["early"][early], values["ends"][early])

    def with_gone(self, tracks: np.ndarray, frame: int) -> "Lifetimes":
        """With others that were gone when a frame came."""
        gone = Lifetimes(tracks[:0], tracks[:0], tracks, np.full(len(tracks), frame))
        return Lifetimes.joined([self, gone])

    def by_track(self, num_tracks: int, num_frames: int) -> tuple[np.ndarray, np.ndarray]:
        """First frame of each track in the group that it is born in, the clip's first frame after it, int64 (T) each.

        Those that are not told about come with their group, and stay.
        """
        begins, ends = np.zeros(num_tracks, np.int64), np.full(num_tracks, num_frames)
        begins[self.late], ends[self.early] = self.begins, self.ends
        return begins, ends

    def most_seen(self, seen: np.ndarray, count: int) -> "Lifetimes":
        """What is told of the tracks that are seen most.

        Args:
            seen: How much is seen of each track, float64 (T).
            count: Tracks to keep.
        """
        some = np.union1d(self.late, self.early)
        keep = some[np.argsort(-seen[some], kind="stable")[:count]]
        late, early = np.isin(self.late, keep), np.isin(self.early, keep)
        return Lifetimes(self.late[late], self.begins[late], self.early[early], self.ends[early])


def lifetimes_sections(lifetimes: Lifetimes) -> dict[str, bytes]:
    """The named section; none where all tracks are there all the time."""
    if not len(lifetimes.late) + len(lifetimes.early):
        return {}
    writer = ByteWriter()
    for tracks, frames in ((lifetimes.late, lifetimes.begins), (lifetimes.early, lifetimes.ends)):
        writer.unsigned(len(tracks))
        for apart, frame in zip((np.diff(tracks, prepend=-1) - 1).tolist(), frames.tolist(), strict=True):
            writer.unsigned(apart)
            writer.unsigned(frame)
    return {SECTION: writer.bytes()}


def read_lifetimes(sections: Mapping[str, bytes], births: Sequence[int], timeline: Timeline) -> Lifetimes:
    """Reads the named section; nothing is told where there is none.

    Args:
        sections: Named sections of the stream.
        births: Tracks that are born in each group.
        timeline: When the frames are.

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
    found = Lifetimes(*values)
    some = np.union1d(found.late, found.early)
    own = Lifetimes(np.searchsorted(some, found.late), found.begins, np.searchsorted(some, found.early), found.ends)
    begins, ends = own.by_track(len(some), timeline.num_frames)
    first = np.searchsorted(np.cumsum(births), some, side="right") * timeline.group_frames
    if (begins >= timeline.group_frames).any() or (first + begins >= ends).any():
        raise BitstreamError(f"section '{SECTION}': a track ends before it begins")
    return found
