"""Groups of frames to packets, one group after another: what is there at the end is a stream."""

import functools
import hashlib
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np

from splatwire.codec.background import background_sections
from splatwire.codec.schemas.gaussians.attributes import update_digest as digest_bases
from splatwire.codec.schemas.gaussians.quality import Quality
from splatwire.codec.schemas.tracks.bases import BaseEncoder, span_size
from splatwire.codec.schemas.tracks.fitting import Fitting, fit, judged
from splatwire.codec.schemas.tracks.known_tracks import KnownTracks
from splatwire.codec.schemas.tracks.layout import AFTER, BEFORE, BEGINS, ENDS, MOVING, NUM_CONTEXTS, STATE, TRACK
from splatwire.codec.schemas.tracks.lifetimes import BYTES_OF_ONE, Lifetimes, lifetimes_sections
from splatwire.codec.schemas.tracks.motion_coder import FIRST_COST, MotionCoder, all_stay
from splatwire.codec.schemas.tracks.motion_rows import update_digest as digest_motion
from splatwire.codec.schemas.tracks.sending import by_turns, dearest_first
from splatwire.codec.schemas.tracks.side_info import ClipInfo, Group, write_side_info
from splatwire.codec.schemas.tracks.steps import motion_shifts
from splatwire.codec.schemas.tracks.track_group import TrackGroup
from splatwire.codec.schemas.tracks.trajectories import Targets, Trajectories
from splatwire.codec.threads import ordered_map
from splatwire.errors import InvalidValueError
from splatwire.model.clip import Timeline
from splatwire.packets import (
    HEADER_BYTES,
    Manifest,
    Packet,
    PacketId,
    Packetization,
    SceneStream,
    make_packet,
    make_stream,
)
from splatwire.packets.limits import TRACKS
from splatwire.packets.tiers import TierShape
from splatwire.scene.background import BLACK, Background
from splatwire.scene.splats import Splats
from splatwire.version import __version__

DATAGRAMS = Packetization(block_size=4800, lanes=1, grouping="hashed", packet_bytes=1150)
"""How clips are split: into packets that fit a datagram, of thousands of tracks, so that around a lost one most arrive.
Of blocks of 1200, which take 0.82 to 0.93 of the bytes, a packet is most: 20 % lost cost 4.7 dB there, 0.6 dB here."""
COARSER = np.array([2, 3, 2, 2, 2], dtype=np.int64)
"""Octaves by which steps of motion are larger than those of bases, by kind."""
LIVE_GROUPS = 2
"""Groups whose lifetimes side information has while a clip goes on: of older ones motion has said who is gone."""


class ClipWriter:
    """Codes groups of frames one after another.

    Args:
        rate: Frames a second.
        group_frames: Frames of a group; only the last one may have fewer.
        quality: How finely Gaussians are quantised.
        background: RGB behind everything.
        packetization: How tracks are split; packets cut by their size.
        threads: Threads to use, which changes no bit; None for one for each processor.
    """

    def __init__(
        self, rate: Fraction, group_frames: int, quality: Quality, background: Background = BLACK,
        packetization: Packetization = DATAGRAMS, threads: int | None = None,
    ) -> None:  # fmt: skip
        if not packetization.hashed:
            raise InvalidValueError("packets of a clip are cut by their size: choose hashed grouping")
        self._rate, self._group_frames = rate, group_frames
        self._packetization, self._threads = packetization, threads
        self._sections: Mapping[str, bytes] = background_sections(background)
        self._bases = BaseEncoder(quality, packetization, threads)
        self._zero: np.ndarray | None = None
        self._groups: list[Group] = []
        self._lifetimes: list[Lifetimes] = []
        self._packets: list[Packet] = []
        self._num_blocks = self._num_frames = self._num_tracks = 0
        self._digest = hashlib.sha256()
        self._known = KnownTracks.empty()
        self._fitting: Fitting | None = None
        self.worth: dict[PacketId, float] = {}
        self._costs = np.zeros(0)

    def fit(self, splats: Splats, classes: np.ndarray | None) -> None:
        """Fits what all bases share to these Gaussians, before the first group, see `BaseEncoder.fit`."""
        self._bases.fit(splats, classes)

    def look(self, keys: np.ndarray, moves: Trajectories, end: int) -> None:
        """Looks at frames of the next group before all of them are there, so that less is left to do then.

        Args:
            keys: Its tracks so far, see `TrackGroup`.
            moves: What they do, over all of its frames.
            end: Frames that are there; of the others anything.
        """
        if self._groups:
            self._fitting = self._fitting or self._fit(keys, moves)
            self._fitting.look(moves, end)

    def add(self, group: TrackGroup, classes: np.ndarray | None = None) -> list[Packet]:
        """Codes the next group.

        Args:
            group: Its tracks.
            classes: Class of precision of each; None for the finest in the first group, and later for a middle one.

        Returns:
            Its packets, of no stream yet, in the order in which they shall leave: bases, then motion. `worth` says how
            much is seen of what is in each.

        Raises:
            InvalidValueError: If nothing in the first group draws anything, or a track is too far away.
        """
        if not len(group.keys) and not self._groups:
            raise InvalidValueError("there is no Gaussian that draws anything in the first frames")
        if not len(group.keys) and len(self._known.alive):  # no track at all would say that all stay as they were
            group = self._known.leaving(group.moves.num_frames)
        self.worth = {}
        first_new = self._num_tracks
        numbers, new, moving, targets = self._begin_anew(group)
        old, born = np.flatnonzero(~new), np.flatnonzero(new)
        by = np.concatenate([old[np.argsort(numbers[old])], born])
        self._num_tracks += len(born)
        self._costs = np.concatenate([self._costs, np.full(len(born), FIRST_COST)])
        most = self._packetization.packet_bytes - HEADER_BYTES
        coder = MotionCoder.of(len(by), targets.coefficients, first_new, most)

        @functools.cache
        def births() -> list[Packet]:
            """Tracks that are born; what the others do is coded meanwhile."""
            packets = self._births(group, classes, born, numbers)
            threads, who = 1 if len(old) else self._threads, np.where(new, numbers, -1)
            fit(targets, group.moves, self._known, self._bases.info, who, (0, group.moves.num_frames), threads)
            own = targets.largest[born], targets.turns[born]
            _, moving[born] = judged(*own, self._known.shifts, numbers[born])
            by[len(old) :] = born[np.argsort(numbers[born])]
            self._tell(coder, slice(len(old), None), group, by, numbers, moving)
            return packets

        self._tell(coder, slice(len(old)), group, by, numbers, moving)
        motions, moved = self._motions(group, coder, len(old), births)
        self._groups.append(Group(len(born), motions))
        count = sum(packet.num_bytes for packet in [*births(), *moved]) // BYTES_OF_ONE
        numbers, begins, ends = numbers[by], group.begins[by], group.ends[by]
        late, early = (numbers >= first_new) & (begins > 0), ends < group.moves.num_frames
        lifetimes = Lifetimes(numbers[late], begins[late], numbers[early], self._num_frames + ends[early])
        lifetimes = lifetimes.with_gone(np.setdiff1d(self._known.alive, numbers, assume_unique=True), self._num_frames)
        self._lifetimes.append(lifetimes.most_seen(self._known.weights, count))
        self._known = replace(self._known, alive=numbers[~early])
        self._num_frames += group.moves.num_frames
        self._packets += [*births(), *moved]
        return dearest_first(births(), self.worth) + by_turns(moved, self.worth)

    def finish(self, sections: Mapping[str, bytes]) -> SceneStream:
        """The stream of all groups, with more named sections."""
        side_info, tiers = self._stated(sections, self._lifetimes)
        return make_stream(
            packetization=self._packetization, num_elements=sum(tier.num_elements for tier in tiers),
            side_info=side_info, packets=self._packets, symbols_digest=self._digest.hexdigest(),
            writer=f"splatwire {__version__}", tiers=tiers, codec=TRACKS,
        )  # fmt: skip

    def so_far(self, sections: Mapping[str, bytes], stream_id: int) -> tuple[Manifest, bytes]:
        """Manifest and side information of the groups so far, of a stream whose id was chosen before its end."""
        side_info, tiers = self._stated(sections, self._lifetimes[-LIVE_GROUPS:])
        manifest = Manifest(
            packetization=self._packetization, num_elements=sum(tier.num_elements for tier in tiers),
            num_packets=len(self._packets), stream_id=stream_id, side_info_bytes=len(side_info),
            side_info_digest=hashlib.sha256(side_info).hexdigest(), symbols_digest=self._digest.hexdigest(),
            writer=f"splatwire {__version__}", tiers=tiers, codec=TRACKS,
        )  # fmt: skip
        return manifest, side_info

    def _stated(
        self, sections: Mapping[str, bytes], lifetimes: Sequence[Lifetimes]
    ) -> tuple[bytes, tuple[TierShape, ...]]:
        """Side information and tiers of the groups so far."""
        timeline = Timeline(self._rate, self._num_frames, self._group_frames)
        zero = np.full(NUM_CONTEXTS, 128) if self._zero is None else self._zero
        named = {**self._sections, **sections, **lifetimes_sections(Lifetimes.joined(lifetimes))}
        info = ClipInfo(timeline, tuple(self._groups), self._bases.info, COARSER, zero, named)
        tiers = tuple(TierShape(count, 1) for group in self._groups for count in (group.births, group.motions))
        return write_side_info(info), tiers

    def _begin_anew(self, group: TrackGroup) -> tuple[np.ndarray, np.ndarray, np.ndarray, Targets]:
        """Numbers of tracks, which of them need a base (new ones, or far from theirs), which move, and targets.

        Targets are those of tracks that need none; of the others zero.
        """
        count, frames = len(group.keys), group.moves.num_frames
        fitting, self._fitting = self._fitting, None
        if not self._groups:
            return np.full(count, -1), np.ones(count, bool), np.zeros(count, bool), Targets.zero(count, frames)
        if fitting is None or not fitting.fits(group.keys, frames):
            fitting = self._fit(group.keys, group.moves)
            fitting.look(group.moves, frames)
        targets = fitting.finish(group.keys, group.moves, (group.begins == 0) & (group.ends == frames))
        new = fitting.numbers < 0
        known = np.maximum(fitting.numbers, 0)
        far, moving = judged(targets.largest, targets.turns, self._known.shifts, known)
        anew = np.flatnonzero(far & ~new)
        targets.put(anew, Targets.zero(len(anew), frames))
        return fitting.numbers, new | far, moving, targets

    def _fit(self, keys: np.ndarray, moves: Trajectories) -> Fitting:
        return Fitting(keys, self._known, self._bases.info, moves.num_frames, self._threads)

    def _births(
        self, group: TrackGroup, classes: np.ndarray | None, where: np.ndarray, numbers: np.ndarray
    ) -> list[Packet]:
        """Codes the bases of some tracks, which get numbers."""
        if not len(where):
            return []
        coded = self._bases.encode(group.first(where), None if classes is None else classes[where])
        born = where[coded.order]
        bases = group.moves.at(born, np.zeros_like(born))
        shifts = motion_shifts(coded.rows, self._bases.info, COARSER)
        first_new = len(self._known.keys)
        self._known = self._known.with_births(bases, group.keys[born], coded.rows, shifts)
        for rows in coded.digested:
            digest_bases(self._digest, rows)
        numbers[born] = np.arange(first_new, len(self._known.keys))
        return self._named(coded.packets, coded.num_blocks, self._known.weights[first_new:])

    def _tell(
        self, coder: MotionCoder, some: slice, group: TrackGroup, by: np.ndarray, numbers: np.ndarray,
        moving: np.ndarray,
    ) -> None:  # fmt: skip
        """Tells a coder of some tracks, by their numbers."""
        rows, known, tracks = by[some], self._known, numbers[by[some]]
        heads = coder.heads[some]
        before = coder.heads[some.start - 1, TRACK] if some.start else -1
        heads[:, TRACK], heads[:, BEGINS], heads[:, ENDS] = tracks, group.begins[rows], group.ends[rows]
        heads[:, BEFORE] = np.diff(tracks, prepend=before) - 1
        heads[:, STATE] = np.where(moving[rows], MOVING, 0)
        if len(rows) and len(rows) + (some.start or 0) == len(by):
            heads[-1, AFTER] = self._num_tracks - 1 - tracks[-1]
        coder.rows[some], coder.costs[some] = rows, self._costs[tracks]
        coder.places[some], coder.shifts[some] = known.rows[tracks, :3], known.shifts[tracks]

    def _motions(
        self, group: TrackGroup, coder: MotionCoder, known: int, births: Callable[[], list[Packet]]
    ) -> tuple[int, list[Packet]]:
        """Codes what tracks do, of which a coder knows some; nothing where all stay as they were."""
        heads, frames = coder.heads, group.moves.num_frames
        if all_stay(heads[:known], frames) and np.array_equal(self._known.alive, heads[:known, TRACK]):
            births()
            if all_stay(heads, frames):
                return 0, []
        packets, self._costs[heads[:, TRACK]] = self._cut(coder, known, births)
        return len(heads), packets

    def _cut(
        self, coder: MotionCoder, known: int, births: Callable[[], list[Packet]]
    ) -> tuple[list[Packet], np.ndarray]:
        """Packets of all tracks, block by block, and what each track took."""
        heads = coder.heads
        size = span_size(len(heads), self._packetization.block_size)
        parts = list(itertools.pairwise([*range(0, len(heads), size), len(heads)]))
        if self._zero is None:
            births()
            self._zero = coder.fitted(parts, self._threads)

        def ready() -> Iterator[tuple[int, int]]:
            for begin, end in parts:
                if end > known:
                    births()
                yield begin, end

        packets, costs = [], []
        coded = ordered_map(functools.partial(coder.encode, self._zero), ready(), self._threads)
        for block, ((begin, end), part) in enumerate(zip(parts, coded, strict=True)):
            births()  # which the digest takes first
            packets += part.packets(block)
            digest_motion(self._digest, (heads[begin:end], part.residuals))
            costs.append(part.costs)
        seen = self._known.weights[heads[:, TRACK]] * (heads[:, STATE] == MOVING)
        return self._named(packets, len(parts), seen), np.concatenate(costs)

    def _named(self, packets: list[Packet], num_blocks: int, seen: np.ndarray) -> list[Packet]:
        """Packets of a run of blocks at its place in the stream; takes down how much is seen of what is in each."""
        first = self._num_blocks
        self._num_blocks += num_blocks
        named = [make_packet(PacketId(first + p.id.block, p.id.lane), p.num_elements, p.payload) for p in packets]
        ends = np.cumsum([0, *(packet.num_elements for packet in packets)])
        sums = np.add.reduceat(seen, ends[:-1]).tolist()
        self.worth |= {packet.id: worth for packet, worth in zip(named, sums, strict=True)}
        return named
