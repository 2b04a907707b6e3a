"""Encodes the motion of a group's tracks (Gaussians over time) in packets."""

import functools
import itertools
from dataclasses import dataclass, replace

import numpy as np

from splatwire.bitstream import Packet, PacketId, make_packet
from splatwire.codec.gaussians.fit import fit_zero_probabilities
from splatwire.codec.sequence import _packet_kernels as kernels
from splatwire.codec.sequence.layout import BEGINS, ENDS, HEADER_FIELDS, NUM_CHANNELS, NUM_CONTEXTS, STATE, STILL
from splatwire.codec.threads import ordered_map

DEAD_ZONE_WIDENING = 8
"""Widening of the dead zone of the encoder's quantiser, in 64ths of a quantisation step, see `predict_from_neighbours`.
"""
FITTED_ROUNDS, FITTED_BLOCKS = 2, 4
BYTES_PER_COEFFICIENT = 5
INITIAL_TRACK_BYTES = 4.0
"""Expected number of bytes for the motion of a track that has not been coded before."""


@dataclass(frozen=True, eq=False)
class CodedMotion:
    """Encoded block with the motion of n tracks (Gaussians over time) over F frames.

    Attributes:
        counts: Number of tracks in each packet, int64 (packets).
        payloads: Content of each packet without its header.
        residuals: Quantised prediction residuals of the motion coefficients, int32 (n, channels * frames).
        bit_counts: Number of zeros and ones coded with each adaptive bit model, int64 (contexts, 2).
    """

    counts: np.ndarray
    payloads: list[bytes]
    residuals: np.ndarray
    bit_counts: np.ndarray

    def packets(self, block: int) -> list[Packet]:
        """Returns the packets with the coded motion of a block."""
        starts = (np.cumsum(self.counts) - self.counts).tolist()
        parts = zip(starts, self.counts.tolist(), self.payloads, strict=True)
        return [make_packet(PacketId(block, start), count, payload) for start, count, payload in parts]

    @property
    def costs(self) -> np.ndarray:
        """Number of bytes for the motion of each track, float64 (n)."""
        # The size of a packet is divided equally among its tracks.
        return np.repeat((np.array([len(payload) for payload in self.payloads]) + 1.0) / self.counts, self.counts)


def all_stay(headers: np.ndarray, num_frames: int) -> bool:
    """True if no Gaussian of a group of frames moves, begins or ends.

    Args:
        headers: Header of each track in the motion packets (state, first frame, end and others), int64 (n, fields).
        num_frames: Number of frames in the group.
    """
    return bool(((headers[:, STATE] == STILL) & (headers[:, BEGINS] == 0) & (headers[:, ENDS] == num_frames)).all())


@dataclass(frozen=True, eq=False)
class MotionCoder:
    """Encoder for the motion of n tracks (Gaussians over time) in a group of F frames, in packets of limited size.

    `MotionCoder.of` creates arrays of zeros. The caller fills them before encoding.

    Attributes:
        headers: Header of each track in the motion packets (state, first frame, end and others), ascending by track
            index, int64 (n, fields).
        positions: Positions of the tracks' keyframe Gaussians, in units of motion, int64 (n, 3).
        shifts: log2 of the quantisation steps of the tracks' motion, int64 (n, channels).
        targets: Motion coefficients before quantisation, float64 (N, channels, F). N may be larger than n.
        rows: Index in `targets` of each track, int64 (n).
        first_new: Index in the stream of the first track that begins in the group.
        max_payload_bytes: Maximum size of a packet's payload, bytes.
        costs: Expected number of bytes for each track, float64 (n).
    """

    headers: np.ndarray
    positions: np.ndarray
    shifts: np.ndarray
    targets: np.ndarray
    rows: np.ndarray
    first_new: int
    max_payload_bytes: int
    costs: np.ndarray

    @staticmethod
    def of(count: int, targets: np.ndarray, first_new: int, max_payload_bytes: int) -> "MotionCoder":
        """Creates a coder with zero arrays for `count` tracks.

        Args:
            count: Number of tracks to encode.
            targets: Motion coefficients before quantisation, float64 (N, channels, frames). The array may also contain
                tracks that are not encoded.
            first_new: Index in the stream of the first track that begins in the group.
            max_payload_bytes: Maximum size of a packet's payload, bytes.
        """
        headers, rows = np.zeros((count, HEADER_FIELDS), np.int64), np.zeros(count, np.int64)
        positions, shifts = np.zeros((count, 3), np.int64), np.zeros((count, NUM_CHANNELS), np.int64)
        return MotionCoder(headers, positions, shifts, targets, rows, first_new, max_payload_bytes, np.zeros(count))

    def fit_zero_probabilities(self, block_ranges: list[tuple[int, int]], threads: int | None) -> np.ndarray:
        """Fits the initial states of the adaptive bit models to a sample of the blocks.

        Args:
            block_ranges: First track and end (exclusive) of each block, as indices of the coder's tracks.
            threads: Number of threads; None for one per processor.

        Returns:
            Initial probability that a bit is 0, for each model, out of 2**8, int64 (contexts).
        """
        zero_probabilities = np.full(NUM_CONTEXTS, 128, dtype=np.int64)
        samples = [
            block_ranges[i]
            for i in sorted({*np.linspace(0, len(block_ranges) - 1, min(len(block_ranges), FITTED_BLOCKS)).astype(int)})
        ]
        coder = self
        for _ in range(FITTED_ROUNDS):
            coded = list(ordered_map(functools.partial(coder.encode, zero_probabilities), samples, threads))
            zero_probabilities = fit_zero_probabilities(np.sum([block.bit_counts for block in coded], axis=0))
            coder = replace(self, costs=self.costs.copy())
            for (begin, end), block in zip(samples, coded, strict=True):
                coder.costs[begin:end] = block.costs
        return zero_probabilities

    def encode(self, zero_probabilities: np.ndarray, track_range: tuple[int, int]) -> CodedMotion:
        """Encodes the motion of the tracks (Gaussians over time) of one block.

        Args:
            zero_probabilities: Initial probability that a bit is 0, for each adaptive bit model, out of 2**8, int64
                (contexts).
            track_range: Range of the block's tracks among the coder's tracks: first index and end (exclusive).
        """
        begin, end = track_range
        count, num_frames, selected = end - begin, self.targets.shape[2], slice(begin, end)
        models, bit_counts = (
            np.repeat(zero_probabilities[:, None] << 8, 2, axis=1),
            np.zeros((NUM_CONTEXTS, 2), dtype=np.int64),
        )
        residuals = np.zeros((count, NUM_CHANNELS, num_frames), dtype=np.int32)
        capacity = kernels.SPARE_BYTES + kernels.TRACK_BYTES * count + BYTES_PER_COEFFICIENT * residuals.size
        buffer, counts, payload_ends = (
            np.zeros(capacity, np.uint8),
            np.zeros(count, np.int64),
            np.zeros(count, np.int64),
        )
        num_packets = kernels.encode_limited(
            models, bit_counts, np.int64(num_frames), np.int64(self.first_new), np.int64(DEAD_ZONE_WIDENING),
            self.headers[selected], self.positions[selected], self.shifts[selected], self.targets, self.rows[selected],
            np.int64(self.max_payload_bytes), self.costs[selected], buffer, residuals, counts, payload_ends,
        )  # fmt: skip
        bounds = [0, *payload_ends[:num_packets].tolist()]
        payloads = [buffer[a:b].tobytes() for a, b in itertools.pairwise(bounds)]
        return CodedMotion(counts[:num_packets], payloads, residuals.reshape(count, -1), bit_counts)
