"""Trajectories as coefficients, and coefficients as what they do to a base."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from splatwire.codec.schemas.gaussians.attributes import LUMA_CHROMA
from splatwire.codec.schemas.gaussians.layout import BITS, DIRECTION_BITS
from splatwire.codec.schemas.tracks.basis import polynomials
from splatwire.codec.schemas.tracks.layout import KIND_OF, NUM_CHANNELS
from splatwire.codec.threads import ordered_map
from splatwire.ops.spherical_harmonics import DC
from splatwire.ops.threads import share

_TURN = float(1 << DIRECTION_BITS)
_FIXED = float(1 << BITS)
RUN, AT_ONCE = 2048, 8192
"""Tracks whose coefficients a thread finds at a time, and offsets."""


@dataclass(frozen=True, eq=False)
class Trajectories:
    """n tracks over the F frames of a group; before and after a track is there it stays as it is at that end.

    Attributes:
        means: float32 (n, F, 3).
        quats: Unit quaternions (w, x, y, z), float32 (n, F, 4).
        scales: float32 (n, F, 3).
        opacities: float32 (n, F).
        colours: Constants of the harmonics, float32 (n, F, 3).
    """

    means: np.ndarray
    quats: np.ndarray
    scales: np.ndarray
    opacities: np.ndarray
    colours: np.ndarray

    @property
    def num_frames(self) -> int:
        """Frames, F."""
        return int(self.means.shape[1])

    def select(self, index: np.ndarray | slice) -> "Trajectories":
        """The tracks at `index`."""
        return replace(self, **{name: values[index] for name, values in vars(self).items()})

    def at(self, index: np.ndarray, frame: np.ndarray) -> "Trajectories":
        """The tracks at `index`, each at a frame of its own, as trajectories of one frame."""
        return replace(self, **{name: values[index, frame][:, None] for name, values in vars(self).items()})


@dataclass(frozen=True, eq=False)
class Targets:
    """Coefficients of what n tracks do, relative to their bases, in units of the channels.

    Attributes:
        coefficients: float64 (n, C, F).
        largest: Largest magnitude of each channel's, float64 (n, C).
        turns: Largest rotation of each, the tangent of a quarter of its angle, float64 (n).
        last: Rotation of each in the last frame, unit quaternions that go on from frame to frame, float64 (n, 4).
    """

    coefficients: np.ndarray
    largest: np.ndarray
    turns: np.ndarray
    last: np.ndarray

    @staticmethod
    def zero(count: int, frames: int) -> "Targets":
        """Of tracks that do nothing."""
        values, last = np.zeros((count, NUM_CHANNELS, frames)), np.zeros((count, 4))
        last[:, 0] = 1
        return Targets(values, np.zeros((count, NUM_CHANNELS)), np.zeros(count), last)

    def select(self, index: np.ndarray | slice) -> "Targets":
        """Those at `index`."""
        return Targets(**{name: values[index] for name, values in vars(self).items()})

    def put(self, index: np.ndarray, others: "Targets") -> None:
        """Replaces those at `index`."""
        for name, values in vars(self).items():
            values[index] = getattr(others, name)


def targets_of(
    moves: Trajectories, bases: Trajectories, numbers: np.ndarray, unit: int, size_log: int, threads: int | None = None
) -> Targets:
    """Coefficients of what tracks do; rotations go on from frame to frame, so that they may be up to a whole turn.

    Args:
        moves: n tracks over F frames.
        bases: How tracks were when they were born, one frame each.
        numbers: Which base each of the n has, int64 (n).
        unit: `-log2` of the lattice's unit, relative to the scene's size.
        size_log: log2 of the scene's size.
        threads: Threads to use, which changes no bit; None for one for each processor.
    """
    found = Targets.zero(len(numbers), moves.num_frames)
    add_frames(found, moves, bases, numbers, 0, moves.num_frames, unit, size_log, threads)
    return found


def add_frames(
    found: Targets, moves: Trajectories, bases: Trajectories, numbers: np.ndarray, begin: int, end: int,
    unit: int, size_log: int, threads: int | None = None,
) -> None:  # fmt: skip
    """Adds some frames to coefficients of frames before: the same bits as of all at once.

    Args:
        found: The coefficients, which are changed; their magnitudes are there with the last frame.
        moves: n tracks over F frames; what is in those from `end` on does not matter.
        bases: See `targets_of`.
        numbers: See there; nothing is said of tracks whose number is below 0.
        begin: First frame that was not added before.
        end: First frame after those that are added.
        unit: See `targets_of`.
        size_log: See there.
        threads: See there.
    """
    from splatwire.codec.schemas.tracks import _target_kernels as kernels

    luma, table = np.ascontiguousarray(LUMA_CHROMA * (DC * _FIXED)), polynomials(moves.num_frames).copy()
    known, scale = tuple(vars(bases).values()), float(np.ldexp(1.0, unit + 1 - size_log))

    def fit(some: slice) -> None:
        kernels.fit_targets(
            tuple(values[some] for values in vars(moves).values()), known, numbers[some], scale, luma, table,
            np.int64(begin), np.int64(end), *(values[some] for values in vars(found).values()),
        )  # fmt: skip

    runs = [slice(first, first + RUN) for first in range(0, len(numbers), RUN)]
    for _ in ordered_map(fit, runs, threads if len(runs) > 1 else 1):
        pass


@dataclass(frozen=True, eq=False)
class PacketMoves:
    """What a packet says of its tracks that move.

    Attributes:
        coefficients: float32 (m, C, K).
        orders: How many of the K of each kind are not 0, int64 (kinds).
    """

    coefficients: np.ndarray
    orders: np.ndarray

    @property
    def nbytes(self) -> int:
        """Bytes of memory."""
        return self.coefficients.nbytes


@dataclass(frozen=True, eq=False)
class Offsets:
    """How tracks of a group differ from their bases, frame by frame.

    Args:
        moves: What packets say of tracks that move.
        frames: Frames of the group.
        unit: As for `targets_of`.
        size_log: As there.
    """

    moves: Sequence[PacketMoves]
    frames: int
    unit: int
    size_log: int

    def of(self, rows: np.ndarray) -> Callable[[int], np.ndarray]:
        """Of some tracks.

        Args:
            rows: Which of those that move each one is, in the order of the packets, int64 (n); -1 if it does not.

        Returns:
            For a frame of the group: float32 (n, C) as in `splatwire.model.clip.GroupMotion.at`.
        """
        from splatwire.codec.schemas.tracks import _offset_kernels as kernels

        counts = [len(packet.coefficients) for packet in self.moves]
        widths = np.array([packet.coefficients.shape[2] for packet in self.moves], np.int64)
        sizes, packets = NUM_CHANNELS * widths, np.repeat(np.arange(len(counts)), counts)
        ends = np.concatenate([[0], np.cumsum(np.repeat(sizes, counts))]).astype(np.int64)
        flat = np.concatenate([np.zeros(0, np.float32), *(packet.coefficients.ravel() for packet in self.moves)])
        orders = np.array([packet.orders[KIND_OF] for packet in self.moves], np.int64).reshape(-1, NUM_CHANNELS)
        starts = np.where(rows < 0, -1, ends[rows])
        own = np.concatenate([packets, [0]])[rows]  # of one that stands still it does not matter
        table, factors, colours = polynomials(self.frames), self._factors(), np.ascontiguousarray(LUMA_CHROMA)

        def at(frame: int) -> np.ndarray:
            found, weights = np.empty((len(rows), NUM_CHANNELS), np.float32), table[frame].copy()

            def part(some: slice) -> None:
                kernels.offsets(
                    flat, starts[some], own[some], orders, widths, weights, factors, colours, found[some]
                )  # fmt: skip

            share(part, [slice(begin, begin + AT_ONCE) for begin in range(0, len(rows), AT_ONCE)])
            return found

        return at

    def _factors(self) -> np.ndarray:
        """Units of the channels, float64 (C)."""
        factors = np.ones(NUM_CHANNELS)
        factors[:3] = np.ldexp(1.0, self.size_log - self.unit - 1)
        factors[3:6] = 1 / _TURN
        factors[6:10] = np.log(2.0) / _FIXED
        factors[10:] = 1 / (_FIXED * DC)
        return factors
