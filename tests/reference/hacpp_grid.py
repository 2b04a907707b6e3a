"""The hash-grid lookup of format 1 in plain numpy, corner by corner."""

import numpy as np

from splatwire.codec.anchors.hacpp.grid_lookup import grid_levels
from splatwire.codec.fixed_point import ACTIVATION_BITS, CELL_BITS, UNIT_BITS
from splatwire.types import HashGridConfig

_PRIMES = (1, 2654435761, 805459861)


def lookup_reference(units: np.ndarray, signs: np.ndarray, config: HashGridConfig) -> np.ndarray:
    """The plain numpy form of `lookup`, corner by corner."""
    levels = grid_levels(config)
    blocks = []
    for start, resolution, rows, axes in zip(levels.starts, levels.resolutions, levels.rows, levels.axes, strict=True):
        used = [a for a in axes if a >= 0]
        at = units[:, used]
        inside = np.asarray(((at >= 0) & (at <= 1 << UNIT_BITS)).all(axis=1))
        scaled = (np.where(inside[:, None], at, 0) * (resolution - 2) + (1 << (UNIT_BITS - 1))) >> (
            UNIT_BITS - CELL_BITS
        )
        cell, fraction = scaled >> CELL_BITS, scaled & ((1 << CELL_BITS) - 1)
        total = np.zeros((len(units), signs.shape[1]), dtype=np.int64)
        weight_sum = np.zeros(len(units), dtype=np.int64)
        for corner in range(1 << len(used)):
            bits = np.array([(corner >> i) & 1 for i in range(len(used))])
            where = cell + bits
            along = np.where(bits == 1, fraction, (1 << CELL_BITS) - fraction)
            dropped = (where <= 0) | (where >= resolution - 1)
            weight = np.asarray(np.where(dropped, 0, along).prod(axis=1))
            total += weight[:, None] * signs[start + _rows_of(where, int(resolution), int(rows))]
            weight_sum += weight
        value = (total << ACTIVATION_BITS) // np.maximum(weight_sum, 1)[:, None]
        blocks.append(np.where(inside[:, None], value, 0))
    return np.concatenate(blocks, axis=1).astype(np.float64)


def _rows_of(corner: np.ndarray, resolution: int, rows: int) -> np.ndarray:
    dims = corner.shape[1]
    if resolution**dims <= rows:
        return (corner * resolution ** np.arange(dims)).sum(axis=1) % rows
    hashed = np.zeros(len(corner), dtype=np.uint64)
    for axis in range(dims):
        hashed ^= (corner[:, axis].astype(np.uint64) * np.uint64(_PRIMES[axis])) & np.uint64(0xFFFFFFFF)
    return (hashed % np.uint64(rows)).astype(np.int64)
