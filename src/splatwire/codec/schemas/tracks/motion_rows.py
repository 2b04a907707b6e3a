"""Decoded integers of motion: what a stream's digest takes of them, and the coefficients that they stand for."""

from typing import Any

import numpy as np

from splatwire.codec.schemas.tracks.layout import HEAD, MOVING, NUM_CHANNELS, STATE


def empty_rows(count: int, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Arrays for decoded integers: heads int64 (count, HEAD), residuals int32 (count, C F)."""
    return np.zeros((count, HEAD), np.int64), np.zeros((count, NUM_CHANNELS * frames), np.int32)


def update_digest(digest: Any, rows: tuple[np.ndarray, ...]) -> None:
    """Adds the integers of one block, in the plan's order, to a hashlib object; `rows` as `empty_rows` makes them."""
    digest.update(np.ascontiguousarray(rows[0].astype("<i4")).data)
    digest.update(np.ascontiguousarray(rows[1].astype("<i4")).data)


def coefficients_of(
    heads: np.ndarray, residuals: np.ndarray, orders: np.ndarray, places: np.ndarray, shifts: np.ndarray
) -> np.ndarray:
    """Coefficients of one packet's tracks, int64 (n, C, F).

    Args:
        heads: int64 (n, HEAD).
        residuals: int32 (n, C F).
        orders: How many coefficients of each kind were coded, int64 (kinds).
        places: Places of their bases, half lattice units, int64 (n, 3).
        shifts: log2 of their steps, int64 (n, C).
    """
    from splatwire.codec.schemas.tracks import _predict_kernels as kernels

    quantised = np.ascontiguousarray(residuals.reshape(len(heads), NUM_CHANNELS, -1))
    coefficients = np.zeros(quantised.shape, np.int64)
    kernels.follow_neighbours(
        np.ascontiguousarray(places), np.ascontiguousarray(heads[:, STATE]), shifts, orders, quantised,
        np.zeros((0, 1, 1)), np.int64(0), coefficients,
    )  # fmt: skip
    return coefficients[heads[:, STATE] == MOVING]
