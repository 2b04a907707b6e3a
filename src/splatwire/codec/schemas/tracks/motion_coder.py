"""Motion of a group's tracks to packets."""

import itertools
from dataclasses import dataclass

import numpy as np

from splatwire.codec.schemas.gaussians.fit import fit_bits
from splatwire.codec.schemas.tracks.layout import NUM_CHANNELS, NUM_CONTEXTS

DEAD = 8
"""See `follow_neighbours`: what an encoder favours 0 by, out of 64 steps."""
FITTED_ROUNDS, FITTED_BLOCKS = 2, 16
BYTES_PER_COEFFICIENT = 5


@dataclass(frozen=True, eq=False)
class MotionCoder:
    """Codes the blocks of a group's motion, in packets cut by their size.

    Attributes:
        heads: Of all tracks that are there, int64 (n, HEAD), ascending by track.
        places: Places of their bases, half lattice units, int64 (n, 3).
        shifts: log2 of their steps, int64 (n, C).
        targets: What they do, float64 (n, C, F).
        first_new: First track that is born in the group.
        most: Bytes of a payload.
    """

    heads: np.ndarray
    places: np.ndarray
    shifts: np.ndarray
    targets: np.ndarray
    first_new: int
    most: int

    def fitted(self, edges: list[int]) -> np.ndarray:
        """Initial P(0) of the models out of 2**8, int64 (contexts), from some of the blocks between these edges."""
        zero = np.full(NUM_CONTEXTS, 128, dtype=np.int64)
        blocks = list(itertools.pairwise(edges))
        some = [
            blocks[i] for i in sorted({*np.linspace(0, len(blocks) - 1, min(len(blocks), FITTED_BLOCKS)).astype(int)})
        ]
        for _ in range(FITTED_ROUNDS):
            counts = np.zeros((NUM_CONTEXTS, 2), dtype=np.int64)
            for begin, end in some:
                self._encode(zero, begin, end, counts)
            zero = fit_bits(counts)
        return zero

    def encode(self, zero: np.ndarray, begin: int, end: int) -> tuple[np.ndarray, list[bytes], np.ndarray]:
        """Tracks and payloads of each packet of a block, and the residuals, int32 (n, C F)."""
        return self._encode(zero, begin, end, np.zeros((NUM_CONTEXTS, 2), dtype=np.int64))

    def _encode(
        self, zero: np.ndarray, begin: int, end: int, counts: np.ndarray
    ) -> tuple[np.ndarray, list[bytes], np.ndarray]:
        from splatwire.codec.schemas.tracks import _packet_kernels as kernels

        count, frames, some = end - begin, self.targets.shape[2], slice(begin, end)
        models = np.repeat(zero[:, None] << 8, 2, axis=1)
        residuals = np.zeros((count, NUM_CHANNELS, frames), dtype=np.int32)
        room = kernels.SLACK + kernels.TRACK_BYTES * count + BYTES_PER_COEFFICIENT * residuals.size
        buffer, sizes, ends = np.zeros(room, np.uint8), np.zeros(count, np.int64), np.zeros(count, np.int64)
        used = kernels.encode_cut(
            models, counts, np.int64(frames), np.int64(self.first_new), np.int64(DEAD), self.heads[some],
            self.places[some], self.shifts[some], self.targets[some], np.int64(self.most),
            buffer, residuals, sizes, ends,
        )  # fmt: skip
        bounds = [0, *ends[:used].tolist()]
        payloads = [buffer[a:b].tobytes() for a, b in itertools.pairwise(bounds)]
        return sizes[:used], payloads, residuals.reshape(count, -1)
