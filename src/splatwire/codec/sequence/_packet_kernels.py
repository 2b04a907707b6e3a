"""Numba kernels that encode or decode whole packets of motion, and divide blocks into packets of limited size."""

from typing import no_type_check

import numpy as np

from splatwire.codec._coder_kernels import DECODING, ENCODING, new_coder
from splatwire.codec.sequence._motion_kernels import code_motion
from splatwire.codec.sequence._predict_kernels import pack_coefficients, predict_from_neighbours
from splatwire.codec.sequence.layout import (
    KIND_OF,
    MAX_TRACK_SPAN,
    MOVING,
    NUM_CHANNELS,
    NUM_CONTEXTS,
    NUM_KINDS,
    STATE,
    TRACK,
)
from splatwire.entropy.range_kernels import ZERO, decoder_start, encoder_finish, encoder_start
from splatwire.entropy.word_kernels import words_of
from splatwire.ops.compiled import njit

TARGET_FILL_BITS, MIN_FILL_BITS = 5, 3
"""Parameters of the division of a block into packets of limited size, as in
`splatwire.codec.gaussians._packet_kernels`. The encoder aims at a fraction `1 - 2 ** -TARGET_FILL_BITS` of the maximum
size, and accepts packets above a fraction `1 - 2 ** -MIN_FILL_BITS`.
"""
SPARE_BYTES, TRACK_BYTES = 64, 4
"""Size of an encoder's buffer in addition to the space for coefficients, bytes: `SPARE_BYTES` once, and `TRACK_BYTES`
for the header of each track.
"""


@njit(error_model="numpy")
@no_type_check
def _no_tables():
    """Returns empty probability tables for the constructor of the entropy coder."""
    one = np.zeros(1, np.int64)
    # Motion packets are coded with adaptive bit models only, which need no tables.
    return (
        np.zeros(1, np.uint16),
        np.zeros((1, 6), np.int64),
        np.zeros(1, np.int32),
        np.zeros(1, np.uint16),
        one,
        one,
        one,
    )


@njit(error_model="numpy")
@no_type_check
def _needed_coefficients(targets, rows, states, shifts, num_frames, num_coefficients):
    """Determines how many motion coefficients a packet must contain for each kind of channel.

    A packet contains the coefficients of the lowest degrees. All other coefficients are below half a quantisation step
    in all tracks of the packet.

    Args:
        targets: Motion coefficients before quantisation, float64 (N, channels, degrees); as many degrees as frames.
        rows: Index in `targets` of each track, int64 (n).
        states: `STILL` or `MOVING` for each track, int64 (n).
        shifts: log2 of the quantisation steps of the tracks' motion, int64 (n, channels).
        num_frames: Number of frames in the group.
        num_coefficients: Output: for each kind of channel (position, rotation, scale, opacity, colour), number of
            polynomial coefficients coded per channel, int64 (kinds).
    """
    num_coefficients[:] = 0
    for i in range(len(rows)):
        if states[i] != MOVING:
            continue
        for c in range(NUM_CHANNELS):
            kind = KIND_OF[c]
            for k in range(num_frames - 1, num_coefficients[kind] - 1, -1):
                if 2 * abs(targets[rows[i], c, k]) >= np.float64(np.int64(1) << shifts[i, c]):
                    num_coefficients[kind] = k + 1
                    break


@njit(error_model="numpy")
@no_type_check
def _trim(quantised, num_coefficients):
    """Excludes the motion coefficients of the highest degrees from a packet if they are 0 in all tracks.

    The motion of a track (a Gaussian over time) has a polynomial for each channel. All channels of a kind (position,
    rotation, scale, opacity, colour) have the same number of coded coefficients. These are the coefficients of the
    lowest degrees.

    Args:
        quantised: Quantised prediction residuals of the coefficients of the packet's n tracks, in quantisation steps,
            int32 (n, channels, degrees).
        num_coefficients: For each kind of channel, number of coefficients to code per channel, int64 (kinds). Reduced
            in place while the coefficient of the highest degree is 0 in all tracks and channels; 0 if all coefficients
            are 0.
    """
    for kind in range(NUM_KINDS):
        while num_coefficients[kind]:
            has_nonzero = False
            for i in range(len(quantised)):
                for c in range(NUM_CHANNELS):
                    has_nonzero |= KIND_OF[c] == kind and quantised[i, c, num_coefficients[kind] - 1] != 0
            if has_nonzero:
                break
            num_coefficients[kind] -= 1


@njit(error_model="numpy")
@no_type_check
def _encode_packet(
    models, bit_counts, num_frames, first_new, dead_zone, headers, positions, shifts, targets, rows, buffer, residuals
):
    """Encodes the motion of n tracks (Gaussians over time) as one packet, and returns the packet's size in bytes.

    Args:
        models: Initial state of the adaptive bit models, equal for all packets, int64 (contexts, 2).
        bit_counts: Number of zeros and ones coded with each model, int64 (contexts, 2). The bits of this packet are
            added in place.
        num_frames: Number of frames in the group.
        first_new: Index in the stream of the first track that begins in the group.
        dead_zone: Extra width of the interval that the quantiser rounds to 0 (dead zone), in 64ths of a step.
        headers: Headers of the packet's tracks, int64 (n, fields), ascending by track index.
        positions: Positions of the tracks' keyframe Gaussians in units of motion, int64 (n, 3).
        shifts: log2 of the quantisation steps of the tracks' motion, int64 (n, channels).
        targets: Motion coefficients before quantisation, float64 (N, channels, frames).
        rows: Index in `targets` of each track, int64 (n).
        buffer: Output: bytes of the packet, uint8.
        residuals: Output: residuals of coefficients, int32 (n, channels, frames).
    """
    n, num_used = len(headers), 0
    num_coefficients, states = np.zeros(NUM_KINDS, np.int64), headers[:, STATE].copy()
    _needed_coefficients(targets, rows, states, shifts, num_frames, num_coefficients)
    for c in range(NUM_CHANNELS):
        num_used += num_coefficients[KIND_OF[c]]
    used_targets = np.empty((n, num_used))
    pack_coefficients(targets, rows, states, num_coefficients, used_targets)
    residuals[:] = 0
    predict_from_neighbours(
        positions, states, shifts, num_coefficients, residuals, used_targets, dead_zone, np.zeros((0, 1, 1), np.float32)
    )
    _trim(residuals, num_coefficients)
    statistics = bit_counts, np.zeros((1, 1, 1, 2), np.int64)
    coder = new_coder(ENCODING, buffer, np.empty(0, np.int64), models.copy(), statistics, _no_tables())
    encoder_start(coder.state)
    code_motion(coder, headers.copy(), n, num_coefficients, residuals, num_frames, first_new)
    return encoder_finish(buffer, coder.state)


@njit(error_model="numpy")
@no_type_check
def _max_tracks(headers, begin, n):
    """Returns the largest number of tracks in a packet for which the track indices span less than `MAX_TRACK_SPAN`.

    Args:
        headers: Motion headers of the tracks, ascending by track index.
        begin: Row of the packet's first track.
        n: Number of tracks available from this row on.

    Returns:
        Maximum number of tracks, at most `n`.
    """
    while n > 1 and headers[begin + n - 1, TRACK] - headers[begin, TRACK] >= MAX_TRACK_SPAN:
        n -= 1
    return n


@njit(error_model="numpy")
@no_type_check
def _expected_tracks(costs, begin, end, scale, target_bytes):
    """Estimates how many tracks (Gaussians over time), from track `begin` on, fit into a packet of a given size.

    Args:
        costs: Expected number of bytes for each track, float64.
        begin: Index of the first track.
        end: End of the tracks available (exclusive).
        scale: Correction factor, by which `costs` are multiplied.
        target_bytes: Intended size of the packet, bytes.
    """
    total, at = 0.0, begin
    while at < end and (at == begin or (total + costs[at]) * scale <= target_bytes):
        total += costs[at]
        at += 1
    return at - begin


@njit(nogil=True, error_model="numpy")
@no_type_check
def encode_limited(
    models,
    bit_counts,
    num_frames,
    first_new,
    dead_zone,
    headers,
    positions,
    shifts,
    targets,
    rows,
    max_bytes,
    costs,
    buffer,
    residuals,
    counts,
    ends,
):
    """Encodes a block of motion in packets of limited size, each nearly full of tracks (Gaussians over time).

    The encoder aims at 31/32 of the size and accepts a packet above 7/8 of it, or, after seven attempts, any that fits.

    Args:
        models: Initial state of the adaptive bit models, equal for all packets, int64 (contexts, 2).
        bit_counts: Number of zeros and ones coded with each model, int64 (contexts, 2). The bits of all returned
            packets are added in place. Packets that were encoded only to find out how many tracks fit are not counted.
        num_frames: Number of frames in the group, F.
        first_new: Index in the stream of the first track that begins in the group.
        dead_zone: Extra width of the interval that the quantiser rounds to 0 (dead zone), in 64ths of a step.
        headers: Headers of the tracks, int64 (n, fields), ascending by track index.
        positions: Positions of the tracks' keyframe Gaussians in units of motion, int64 (n, 3).
        shifts: log2 of the quantisation steps of the tracks' motion, int64 (n, channels).
        targets: Motion coefficients before quantisation, float64 (N, channels, frames).
        rows: Index in `targets` of each track, int64 (n).
        max_bytes: Maximum size of a packet's payload, bytes.
        costs: Expected number of bytes for each track, above 0, float64 (n).
        buffer: Output: the payloads one after another, uint8.
        residuals: Output: residuals of coefficients, int32 (n, channels, frames).
        counts: Output: number of tracks in each packet, int64 (n).
        ends: Output: end of each payload in the buffer, int64 (n).

    Returns:
        Number of packets.
    """
    total, begin, at, num_packets = len(headers), 0, 0, 0
    aim, scale = max_bytes - (max_bytes >> TARGET_FILL_BITS), 1.0
    packet_bit_counts = np.zeros((NUM_CONTEXTS, 2), np.int64)
    while begin < total:
        num_left = _max_tracks(headers, begin, total - begin)
        low, high, tries, last, length = 0, num_left + 1, 0, 0, 0
        n = _expected_tracks(costs, begin, begin + num_left, scale, aim)
        while high - low > 1 or last != low:
            n = n if high - low > 1 else low
            packet_bit_counts[:] = 0
            tracks = slice(begin, begin + n)
            length = _encode_packet(
                models, packet_bit_counts, num_frames, first_new, dead_zone, headers[tracks], positions[tracks],
                shifts[tracks], targets, rows[tracks], buffer[at:], residuals[tracks],
            )  # fmt: skip
            tries, last = tries + 1, n
            scale = max(length, 1) / costs[begin : begin + n].sum()
            if length <= max_bytes or n == 1:
                low = n
                if n == num_left or length >= max_bytes - (max_bytes >> MIN_FILL_BITS) or tries > 6:
                    break
            else:
                high = n
            n = min(max(_expected_tracks(costs, begin, begin + num_left, scale, aim), low + 1), high - 1)
        bit_counts += packet_bit_counts
        at += length
        counts[num_packets], ends[num_packets] = low, at
        begin += low
        num_packets += 1
    return num_packets


@njit(nogil=True, error_model="numpy")
@no_type_check
def decode_packets(
    models, num_frames, first_new, data, byte_starts, track_starts, headers, num_coefficients, quantised
):
    """Decodes P packets with the motion of n tracks (Gaussians over time) in total.

    The caller initialises all output arrays with 0.

    Args:
        models: Initial state of the adaptive bit models, equal for all packets, int64 (contexts, 2).
        num_frames: Number of frames in the group, F.
        first_new: Index in the stream of the first track that begins in the group.
        data: Payloads of P packets, one after another, uint8.
        byte_starts: int64 (P + 1); packet p has the bytes `data[byte_starts[p]:byte_starts[p + 1]]`.
        track_starts: int64 (P + 1); packet p has the tracks `track_starts[p]` to `track_starts[p + 1]` (exclusive).
        headers: Output: headers of the tracks, int64 (n, fields).
        num_coefficients: Output: for each packet and kind of channel (position, rotation, scale, opacity, colour),
            number of polynomial coefficients coded per channel, int64 (P, kinds).
        quantised: Output: residuals of coefficients, int32 (n, channels, frames).
    """
    statistics = np.zeros((1, 2), np.int64), np.zeros((1, 1, 1, 2), np.int64)
    for p in range(len(track_starts) - 1):
        payload = data[byte_starts[p] : byte_starts[p + 1]]
        coder = new_coder(DECODING, payload, words_of(payload), models.copy(), statistics, _no_tables())
        decoder_start(payload, ZERO, len(payload), coder.state)
        rows = slice(track_starts[p], track_starts[p + 1])
        num_tracks = track_starts[p + 1] - track_starts[p]
        code_motion(coder, headers[rows], num_tracks, num_coefficients[p], quantised[rows], num_frames, first_new)
