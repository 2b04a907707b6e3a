"""Which lane of its block an element rides in: pure arithmetic on ranks, alike at both ends."""

import numpy as np

from splatwire.packets.splitmix64 import splitmix64

CHUNK = 1 << 17
"""Ranks hashed at a time: temporaries stay in the cache, whatever the number of elements."""


def stratified_lanes(start: int, stop: int, lanes: int, seed: int) -> np.ndarray:
    """Lanes of the ranks `start`..`stop`: `SplitMix64(rank XOR seed) mod lanes` (paper 3.2.2, "Hash Interleaving").

    Args:
        start: First global rank.
        stop: One past the last global rank.
        lanes: Number of lanes, M.
        seed: Shared packetization seed, ξ.

    Returns:
        Lane of each rank, uint8, `stop - start`.
    """
    out = np.empty(stop - start, np.uint8)
    for first in range(start, stop, CHUNK):
        last = min(first + CHUNK, stop)
        ranks = np.arange(first, last, dtype=np.uint64)
        out[first - start : last - start] = splitmix64(ranks ^ np.uint64(seed)) % np.uint64(lanes)
    return out


def hash_order(start: int, stop: int, seed: int) -> np.ndarray:
    """Ranks `start`..`stop` sorted by `SplitMix64(rank XOR seed)`: any run of them is spread over the whole block.

    The hash is a bijection, so no two ranks tie.

    Returns:
        Ranks, int64, `stop - start`.
    """
    ranks = np.arange(start, stop, dtype=np.uint64)
    return start + np.argsort(splitmix64(ranks ^ np.uint64(seed)), kind="stable")


def contiguous_bounds(size: int, lanes: int) -> np.ndarray:
    """Bounds of `lanes` consecutive runs of `size` ranks, as equal as possible, the longer ones first.

    Returns:
        Start of each run and the end of the last, int64, `lanes + 1`.
    """
    lane = np.arange(lanes + 1, dtype=np.int64)
    return lane * (size // lanes) + np.minimum(lane, size % lanes)


def contiguous_lanes(size: int, lanes: int) -> np.ndarray:
    """Lanes of the ranks of one block of `size` elements, split into consecutive runs; uint8, `size`."""
    return np.repeat(np.arange(lanes), np.diff(contiguous_bounds(size, lanes))).astype(np.uint8)
