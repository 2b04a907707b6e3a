"""Decoded integers of motion: what a stream's digest takes of them, and the coefficients that they stand for."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from splatwire.codec.schemas.tracks.layout import HEAD, MOVING, NUM_CHANNELS, NUM_KINDS, STATE
from splatwire.codec.schemas.tracks.side_info import ClipInfo


def empty_rows(count: int, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Arrays for decoded integers: heads int64 (count, HEAD), residuals int32 (count, C F)."""
    return np.zeros((count, HEAD), np.int64), np.zeros((count, NUM_CHANNELS * frames), np.int32)


def update_digest(digest: Any, rows: tuple[np.ndarray, ...]) -> None:
    """Adds the integers of one block, in the plan's order, to a hashlib object; `rows` as `empty_rows` makes them."""
    for part in rows:
        digest.update(np.ascontiguousarray(part, dtype="<i4").data)


def decode_motion(
    info: ClipInfo, group: int, counts: np.ndarray, payloads: Sequence[bytes], first_new: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Decodes packets of a group's motion; any bytes decode to something.

    Args:
        info: The stream's side information.
        group: The group.
        counts: int64 (packets), tracks of each.
        payloads: One for each packet.
        first_new: First track that is born in the group.

    Returns:
        Heads int64 (n, HEAD) and residuals int32 (n, C F), packet by packet, and how many coefficients of each kind
        each packet has, int64 (packets, kinds).
    """
    from splatwire.codec.schemas.tracks import _packet_kernels as kernels

    frames = len(info.timeline.frames_of(group))
    data = np.frombuffer(b"".join(payloads) + b"\0", dtype=np.uint8).copy()
    ends = np.concatenate([[0], np.cumsum([len(payload) for payload in payloads])]).astype(np.int64)
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    heads, residuals = empty_rows(int(starts[-1]), frames)
    orders = np.zeros((len(payloads), NUM_KINDS), np.int64)
    kernels.decode_packets(
        info.models(), np.int64(frames), np.int64(first_new), data, ends, starts, heads,
        orders, residuals.reshape(len(heads), NUM_CHANNELS, frames),
    )  # fmt: skip
    return heads, residuals, orders


def coefficients_of(
    heads: np.ndarray, residuals: np.ndarray, orders: np.ndarray, places: np.ndarray, shifts: np.ndarray
) -> np.ndarray:
    """Coefficients of those of one packet's tracks that move, float32 (m, C, K), K the largest of `orders`.

    Args:
        heads: int64 (n, HEAD).
        residuals: int32 (n, C F).
        orders: How many coefficients of each kind were coded, int64 (kinds).
        places: Places of their bases, half lattice units, int64 (n, 3).
        shifts: log2 of their steps, int64 (n, C).
    """
    from splatwire.codec.schemas.tracks import _predict_kernels as kernels

    quantised = np.ascontiguousarray(residuals.reshape(len(heads), NUM_CHANNELS, -1))
    coefficients = np.zeros((len(heads), NUM_CHANNELS, orders.max()), np.float32)
    kernels.follow_neighbours(
        np.ascontiguousarray(places), np.ascontiguousarray(heads[:, STATE]), shifts, orders, quantised,
        np.zeros((0, 1)), np.int64(0), coefficients,
    )  # fmt: skip
    return coefficients[heads[:, STATE] == MOVING]
