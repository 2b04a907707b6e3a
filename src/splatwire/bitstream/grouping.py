"""Divides the plan indices of a spatial block (see `PacketPlan`) among its packets.

The division depends only on the indices and a seed, so that encoder and decoder agree. The codec determines which
element has which plan index.
"""

import numpy as np

from splatwire.bitstream.splitmix64 import splitmix64

CHUNK = 1 << 17
"""Number of indices hashed at a time, so that temporary arrays stay in the CPU cache."""


def stratified_lanes(start: int, stop: int, lanes: int, seed: int) -> np.ndarray:
    """Divides the plan indices of a block among its packets, by a hash of each index.

    This is the "Hash Interleaving" of Section 3.2.2 of the paper that this project implements (docs/paper-map.md).

    Args:
        start: First plan index of the block.
        stop: Index after the last plan index of the block.
        lanes: Number of lanes (packets) per block, M.
        seed: Seed of the hash, ξ.

    Returns:
        For each plan index, index of its packet within the block, 0 to M - 1, uint8 (`stop - start`).
    """
    out = np.empty(stop - start, np.uint8)
    for first in range(start, stop, CHUNK):
        last = min(first + CHUNK, stop)
        plan_indices = np.arange(first, last, dtype=np.uint64)
        out[first - start : last - start] = splitmix64(plan_indices ^ np.uint64(seed)) % np.uint64(lanes)
    return out


def hash_order(start: int, stop: int, seed: int) -> np.ndarray:
    """Returns the plan indices of a block in an order that is random, but the same on every machine (hash order).

    Args:
        start: First plan index of the block.
        stop: Index after the last plan index of the block.
        seed: Seed of the hash.

    Returns:
        The integers from `start` to `stop - 1`, sorted by their hash, int64 (`stop - start`).
    """
    plan_indices = np.arange(start, stop, dtype=np.uint64)
    return start + np.argsort(splitmix64(plan_indices ^ np.uint64(seed)), kind="stable")


def contiguous_bounds(size: int, num_ranges: int) -> np.ndarray:
    """Divides the plan indices of a block into ranges of nearly equal length, one for each packet of the block.

    Args:
        size: Number of elements.
        num_ranges: Number of ranges.

    Returns:
        Start of each range, followed by the end of the last range, int64 (`num_ranges + 1`).
    """
    lane = np.arange(num_ranges + 1, dtype=np.int64)
    return lane * (size // num_ranges) + np.minimum(lane, size % num_ranges)


def contiguous_lanes(size: int, num_packets: int) -> np.ndarray:
    """Divides the plan indices of a block among its packets, in ranges of consecutive indices.

    Args:
        size: Number of elements of the block.
        num_packets: Number of packets.

    Returns:
        For each plan index, index of its packet within the block, uint8 (`size`).
    """
    return np.repeat(np.arange(num_packets), np.diff(contiguous_bounds(size, num_packets))).astype(np.uint8)
