"""Decoded integers of motion: what a stream's digest takes of them, and the coefficients that they stand for."""

from typing import Any

import numpy as np

from splatwire.codec.schemas.tracks.layout import HEAD, KIND_OF, MOVING, NUM_CHANNELS, NUM_KINDS, STATE


def empty_rows(count: int, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Arrays for decoded integers: heads int64 (count, HEAD), residuals int32 (count, C F)."""
    return np.zeros((count, HEAD), np.int64), np.zeros((count, NUM_CHANNELS * frames), np.int32)


def update_digest(digest: Any, rows: tuple[np.ndarray, ...]) -> None:
    """Adds the integers of one block, in the plan's order, to a hashlib object; `rows` as `empty_rows` makes them."""
    digest.update(np.ascontiguousarray(rows[0].astype("<i4")).data)
    digest.update(np.ascontiguousarray(rows[1].astype("<i4")).data)


def coefficients_of(heads: np.ndarray, residuals: np.ndarray, places: np.ndarray, shifts: np.ndarray) -> np.ndarray:
    """Coefficients of one packet's tracks, int64 (n, C, F).

    Args:
        heads: int64 (n, HEAD).
        residuals: int32 (n, C F).
        places: Places of their bases, half lattice units, int64 (n, 3).
        shifts: log2 of their steps, int64 (n, C).
    """
    from splatwire.codec.schemas.tracks import _predict_kernels as kernels

    quantised = np.ascontiguousarray(residuals.reshape(len(heads), NUM_CHANNELS, -1))
    coefficients = np.zeros(quantised.shape, np.int64)
    kernels.follow_neighbours(
        np.ascontiguousarray(places), np.ascontiguousarray(heads[:, STATE]), shifts, _orders(quantised), quantised,
        np.zeros((0, 1, 1)), np.int64(0), coefficients,
    )  # fmt: skip
    return coefficients[heads[:, STATE] == MOVING]


def _orders(quantised: np.ndarray) -> np.ndarray:
    """How many coefficients of each kind are not all zero, int64 (kinds)."""
    used = (quantised != 0).any(axis=0)
    orders = np.zeros(NUM_KINDS, np.int64)
    for channel, kind in enumerate(KIND_OF.tolist()):
        found = np.flatnonzero(used[channel])
        orders[kind] = max(orders[kind], found[-1] + 1 if len(found) else 0)
    return orders
