"""Assigns the elements of a spatial block to packets.

The assignment depends only on the index of each element in plan order (see `PacketPlan`), so that encoder and decoder
agree.
"""

import numpy as np

from splatwire.bitstream.splitmix64 import splitmix64

CHUNK = 1 << 17
"""Number of indices hashed at a time, so that temporary arrays stay in the CPU cache."""


def stratified_lanes(start: int, stop: int, interleave_depth: int, seed: int) -> np.ndarray:
    """Assigns the elements of a block to its packets by a hash of the element's index.

    This is the "Hash Interleaving" of Section 3.2.2 of the paper that this project implements (docs/paper-map.md).

    Args:
        start: Index of the block's first element in plan order (see `PacketPlan`).
        stop: Index after the block's last element.
        interleave_depth: Number of packets per block, M.
        seed: Seed of the hash, ξ.

    Returns:
        For each element, index of its packet within the block, 0 to M - 1, uint8 (`stop - start`).
    """
    out = np.empty(stop - start, np.uint8)
    for first in range(start, stop, CHUNK):
        last = min(first + CHUNK, stop)
        ranks = np.arange(first, last, dtype=np.uint64)
        out[first - start : last - start] = splitmix64(ranks ^ np.uint64(seed)) % np.uint64(interleave_depth)
    return out


def hash_order(start: int, stop: int, seed: int) -> np.ndarray:
    """Returns the elements of a block in an order that is random, but the same on every machine (hash order).

    Elements are given by their index in plan order (see `PacketPlan`), from `start` to `stop - 1`.

    Returns:
        Indices of the elements, int64 (`stop - start`).
    """
    ranks = np.arange(start, stop, dtype=np.uint64)
    return start + np.argsort(splitmix64(ranks ^ np.uint64(seed)), kind="stable")


def contiguous_bounds(size: int, num_ranges: int) -> np.ndarray:
    """Divides the elements of a block into ranges of nearly equal length, one for each packet of the block.

    Args:
        size: Number of elements.
        num_ranges: Number of ranges.

    Returns:
        Start of each range, followed by the end of the last range, int64 (`num_ranges + 1`).
    """
    lane = np.arange(num_ranges + 1, dtype=np.int64)
    return lane * (size // num_ranges) + np.minimum(lane, size % num_ranges)


def contiguous_lanes(size: int, num_packets: int) -> np.ndarray:
    """Assigns the elements of a block to its packets, in ranges of consecutive elements.

    Args:
        size: Number of elements of the block.
        num_packets: Number of packets.

    Returns:
        For each element, index of its packet within the block, uint8 (`size`).
    """
    return np.repeat(np.arange(num_packets), np.diff(contiguous_bounds(size, num_packets))).astype(np.uint8)
