"""Motion of a group's tracks to packets."""

import functools
import itertools
from dataclasses import dataclass, replace

import numpy as np

from splatwire.codec.schemas.gaussians.fit import fit_bits
from splatwire.codec.schemas.tracks.layout import (
    BEGINS,
    ENDS,
    HEAD,
    NUM_CHANNELS,
    NUM_CONTEXTS,
    STATE,
    STILL,
)
from splatwire.codec.threads import ordered_map
from splatwire.packets import Packet, PacketId, make_packet

DEAD = 8
"""See `follow_neighbours`: what an encoder favours 0 by, out of 64 steps."""
FITTED_ROUNDS, FITTED_BLOCKS = 2, 4
BYTES_PER_COEFFICIENT = 5
FIRST_COST = 4.0
"""Bytes that a track is expected to take of which nothing is known."""


@dataclass(frozen=True, eq=False)
class CodedMotion:
    """A block of motion.

    Attributes:
        sizes: Tracks of each packet, int64 (packets).
        payloads: Of each packet.
        residuals: int32 (n, C F).
        counts: How often each bit was coded, int64 (contexts, 2).
    """

    sizes: np.ndarray
    payloads: list[bytes]
    residuals: np.ndarray
    counts: np.ndarray

    def packets(self, block: int) -> list[Packet]:
        """They, of a block."""
        starts = (np.cumsum(self.sizes) - self.sizes).tolist()
        parts = zip(starts, self.sizes.tolist(), self.payloads, strict=True)
        return [make_packet(PacketId(block, start), count, payload) for start, count, payload in parts]

    @property
    def costs(self) -> np.ndarray:
        """Bytes that each track took, those of a packet alike, float64 (n)."""
        return np.repeat((np.array([len(payload) for payload in self.payloads]) + 1.0) / self.sizes, self.sizes)


def all_stay(heads: np.ndarray, frames: int) -> bool:
    """Whether tracks, int64 (n, HEAD), are there in all frames and stand still."""
    return bool(((heads[:, STATE] == STILL) & (heads[:, BEGINS] == 0) & (heads[:, ENDS] == frames)).all())


@dataclass(frozen=True, eq=False)
class MotionCoder:
    """Codes the blocks of a group's motion, in packets cut by their size.

    Attributes:
        heads: Of all tracks that are there, int64 (n, HEAD), ascending by track.
        places: Places of their bases, half lattice units, int64 (n, 3).
        shifts: log2 of their steps, int64 (n, C).
        targets: What they do, float64 (n, C, F), in an order of their own.
        rows: Row of `targets` of each, int64 (n).
        first_new: First track that is born in the group.
        most: Bytes of a payload.
        costs: Bytes that each track is expected to take, float64 (n): the better, the fewer tries.
    """

    heads: np.ndarray
    places: np.ndarray
    shifts: np.ndarray
    targets: np.ndarray
    rows: np.ndarray
    first_new: int
    most: int
    costs: np.ndarray

    @staticmethod
    def of(count: int, targets: np.ndarray, first_new: int, most: int) -> "MotionCoder":
        """A coder of so many tracks, of which it is told before they are coded."""
        heads, rows = np.zeros((count, HEAD), np.int64), np.zeros(count, np.int64)
        places, shifts = np.zeros((count, 3), np.int64), np.zeros((count, NUM_CHANNELS), np.int64)
        return MotionCoder(heads, places, shifts, targets, rows, first_new, most, np.zeros(count))

    def fitted(self, blocks: list[tuple[int, int]], threads: int | None) -> np.ndarray:
        """Initial P(0) of the models out of 2**8, int64 (contexts), from some of the blocks."""
        zero = np.full(NUM_CONTEXTS, 128, dtype=np.int64)
        some = [
            blocks[i] for i in sorted({*np.linspace(0, len(blocks) - 1, min(len(blocks), FITTED_BLOCKS)).astype(int)})
        ]
        coder = self
        for _ in range(FITTED_ROUNDS):
            coded = list(ordered_map(functools.partial(coder.encode, zero), some, threads))
            zero = fit_bits(np.sum([block.counts for block in coded], axis=0))
            coder = replace(self, costs=self.costs.copy())
            for (begin, end), block in zip(some, coded, strict=True):
                coder.costs[begin:end] = block.costs
        return zero

    def encode(self, zero: np.ndarray, ends: tuple[int, int]) -> CodedMotion:
        """Codes the tracks of a block."""
        from splatwire.codec.schemas.tracks import _packet_kernels as kernels

        begin, end = ends
        count, frames, some = end - begin, self.targets.shape[2], slice(begin, end)
        models, counts = np.repeat(zero[:, None] << 8, 2, axis=1), np.zeros((NUM_CONTEXTS, 2), dtype=np.int64)
        residuals = np.zeros((count, NUM_CHANNELS, frames), dtype=np.int32)
        room = kernels.SLACK + kernels.TRACK_BYTES * count + BYTES_PER_COEFFICIENT * residuals.size
        buffer, sizes, stops = np.zeros(room, np.uint8), np.zeros(count, np.int64), np.zeros(count, np.int64)
        used = kernels.encode_cut(
            models, counts, np.int64(frames), np.int64(self.first_new), np.int64(DEAD), self.heads[some],
            self.places[some], self.shifts[some], self.targets, self.rows[some], np.int64(self.most),
            self.costs[some], buffer, residuals, sizes, stops,
        )  # fmt: skip
        bounds = [0, *stops[:used].tolist()]
        payloads = [buffer[a:b].tobytes() for a, b in itertools.pairwise(bounds)]
        return CodedMotion(sizes[:used], payloads, residuals.reshape(count, -1), counts)
