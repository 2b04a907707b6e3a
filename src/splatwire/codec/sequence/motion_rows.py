"""Decoded integers of motion packets."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from splatwire.codec.sequence import _packet_kernels, _predict_kernels
from splatwire.codec.sequence.layout import HEADER_FIELDS, MOVING, NUM_CHANNELS, NUM_KINDS, STATE
from splatwire.codec.sequence.side_info import SequenceInfo


def empty_rows(count: int, num_frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Allocates zero arrays for the decoded motion of tracks (Gaussians over time).

    Args:
        count: Number of tracks.
        num_frames: Number of frames in the group, F.

    Returns:
        Headers, int64 (count, fields), and prediction residuals of motion coefficients, int32 (count, channels *
        frames).
    """
    return np.zeros((count, HEADER_FIELDS), np.int64), np.zeros((count, NUM_CHANNELS * num_frames), np.int32)


def update_digest(digest: Any, rows: tuple[np.ndarray, ...]) -> None:
    """Adds the decoded integers of one block of motion to a hash, with which receivers verify their decoding.

    Args:
        digest: hashlib object that is updated.
        rows: Headers and residuals of the block.
    """
    for part in rows:
        digest.update(np.ascontiguousarray(part, dtype="<i4").data)


def decode_motion(
    info: SequenceInfo, group: int, counts: np.ndarray, payloads: Sequence[bytes], first_new: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Decodes motion packets of one group of frames to integers.

    Args:
        info: The stream's side information.
        group: Index of the group.
        counts: Number of tracks in each packet, int64 (packets).
        payloads: Content of each packet without its header.
        first_new: Index in the stream of the first track that begins in the group.

    Returns:
        Three arrays. The first has the headers of the n tracks of all packets, int64 (n, fields). The second has the
        prediction residuals of the motion of these tracks, int32 (n, channels * frames). The third has, for each packet
        and kind of channel, the number of coefficients per channel, int64 (packets, kinds).
    """
    num_frames = len(info.timeline.frames_of(group))
    data = np.frombuffer(b"".join(payloads) + b"\0", dtype=np.uint8).copy()
    byte_starts = np.concatenate([[0], np.cumsum([len(payload) for payload in payloads])]).astype(np.int64)
    track_starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    headers, residuals = empty_rows(int(track_starts[-1]), num_frames)
    num_coefficients = np.zeros((len(payloads), NUM_KINDS), np.int64)
    _packet_kernels.decode_packets(
        info.models(), np.int64(num_frames), np.int64(first_new), data, byte_starts, track_starts, headers,
        num_coefficients, residuals.reshape(len(headers), NUM_CHANNELS, num_frames),
    )  # fmt: skip
    return headers, residuals, num_coefficients


def coefficients_of(
    headers: np.ndarray, residuals: np.ndarray, num_coefficients: np.ndarray, positions: np.ndarray, shifts: np.ndarray
) -> np.ndarray:
    """Reconstructs the motion of the moving tracks (Gaussians over time) of a packet from prediction residuals.

    Args:
        headers: Headers of the n tracks of the packet (state, first frame, end and others), int64 (n, fields).
        residuals: Prediction residuals of the tracks, int32 (n, channels * frames).
        num_coefficients: For each kind of channel (position, rotation, scale, opacity, colour), number of polynomial
            coefficients coded per channel, int64 (kinds).
        positions: Positions of the tracks' keyframe Gaussians, in units of motion, int64 (n, 3).
        shifts: log2 of the quantisation steps of the tracks' motion, int64 (n, channels).

    Returns:
        Coefficients of the m moving tracks, float32 (m, channels, K) for at most K coefficients per channel.
    """
    quantised = np.ascontiguousarray(residuals.reshape(len(headers), NUM_CHANNELS, -1))
    coefficients = np.zeros((len(headers), NUM_CHANNELS, num_coefficients.max()), np.float32)
    _predict_kernels.predict_from_neighbours(
        np.ascontiguousarray(positions), np.ascontiguousarray(headers[:, STATE]), shifts, num_coefficients, quantised,
        np.zeros((0, 1)), np.int64(0), coefficients,
    )  # fmt: skip
    return coefficients[headers[:, STATE] == MOVING]
