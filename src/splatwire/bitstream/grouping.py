"""Assigns the elements of a spatial block to packets; the packets of a block are called lanes.

The assignment depends only on the index of each element in coding order (its rank), so that encoder and decoder agree.
"""

import numpy as np

from splatwire.bitstream.splitmix64 import splitmix64

CHUNK = 1 << 17
"""Number of ranks hashed at a time, so that temporary arrays stay in the CPU cache."""


def stratified_lanes(start: int, stop: int, lanes: int, seed: int) -> np.ndarray:
    """Assigns elements to lanes (packets of a block) by a hash of their index (paper 3.2.2, "Hash Interleaving").

    The lane is `SplitMix64(rank XOR seed) mod lanes`.

    Args:
        start: Rank (index in coding order) of the first element, counted over the whole scene.
        stop: One past the rank of the last element.
        lanes: Number of lanes (packets per block), M.
        seed: Shared packetization seed, ξ.

    Returns:
        Lane of each element, uint8 (`stop - start`).
    """
    out = np.empty(stop - start, np.uint8)
    for first in range(start, stop, CHUNK):
        last = min(first + CHUNK, stop)
        ranks = np.arange(first, last, dtype=np.uint64)
        out[first - start : last - start] = splitmix64(ranks ^ np.uint64(seed)) % np.uint64(lanes)
    return out


def hash_order(start: int, stop: int, seed: int) -> np.ndarray:
    """Returns the elements of a block in an order that is random, but the same on every machine (hash order).

    Elements are given by their index in coding order (rank), from `start` to `stop - 1`. They are sorted by
    `SplitMix64(rank XOR seed)`. The hash is a bijection, so that no two are equal.

    Returns:
        Ranks, int64 (`stop - start`).
    """
    ranks = np.arange(start, stop, dtype=np.uint64)
    return start + np.argsort(splitmix64(ranks ^ np.uint64(seed)), kind="stable")


def contiguous_bounds(size: int, lanes: int) -> np.ndarray:
    """Divides the elements of a block into ranges of consecutive elements, one for each lane (packet of the block).

    The lengths of the ranges differ by at most one; longer ranges are first.

    Args:
        size: Number of elements.
        lanes: Number of ranges.

    Returns:
        Start of each range and the end of the last one, int64 (`lanes + 1`).
    """
    lane = np.arange(lanes + 1, dtype=np.int64)
    return lane * (size // lanes) + np.minimum(lane, size % lanes)


def contiguous_lanes(size: int, lanes: int) -> np.ndarray:
    """Assigns the elements of a block to lanes (packets of the block); each lane gets consecutive elements.

    Args:
        size: Number of elements of the block.
        lanes: Number of lanes.

    Returns:
        Lane of each element, uint8 (`size`).
    """
    return np.repeat(np.arange(lanes), np.diff(contiguous_bounds(size, lanes))).astype(np.uint8)
