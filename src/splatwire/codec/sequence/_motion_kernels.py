"""Numba kernels that encode or decode the motion of a packet's tracks (Gaussians over time)."""

from typing import no_type_check

import numpy as np

from splatwire.codec._coder_kernels import code_below, code_bit, code_escape, code_raw
from splatwire.codec.sequence.layout import (
    BEGINS,
    C_ABSENT,
    C_BEGINS,
    C_ENDS,
    C_MOVING,
    C_OCTAVE,
    C_ZERO,
    DEGREE_CONTEXTS,
    ENDS,
    GAP_AFTER,
    GAP_BEFORE,
    KIND_OF,
    MAX_OCTAVE,
    MAX_QUANTISED,
    MAX_TRACK_SPAN,
    MOVING,
    NEIGHBOUR_CONTEXTS,
    NUM_CHANNELS,
    NUM_KINDS,
    OCTAVE_CONTEXTS,
    SPAN_BITS,
    STATE,
    TRACK,
    TRACK_BITS,
)
from splatwire.entropy.range_kernels import (
    ADAPTIVE_BITS,
    BOTTOM,
    LOW_MASK,
    ONE,
    RAW_BITS,
    TOP,
    ZERO,
    adaptive_update,
    zero_probability,
)
from splatwire.ops.compiled import njit


@njit(borrows=True, error_model="numpy")
@no_type_check
def _code_headers(coder, headers, n, num_frames, first_new):
    """Encodes or decodes the headers of a packet's tracks (Gaussians over time): index, motion flag and lifetime.

    Args:
        coder: Entropy coder.
        headers: Headers, int64 (n, fields), ascending by track index: input of an encoder, output of a decoder.
        n: Number of tracks in the packet.
        num_frames: Number of frames in the group.
        first_new: Index in the stream of the first track that begins in the group.

    Returns:
        Number of headers; less than `n` if a decoded packet is damaged.
    """
    first = code_raw(coder, headers[0, TRACK], TRACK_BITS)
    gap_before = code_escape(coder, headers[0, GAP_BEFORE])
    count = code_raw(coder, headers[n - 1, TRACK] + 1 - first, SPAN_BITS)
    gap_after = code_escape(coder, headers[n - 1, GAP_AFTER])
    num_headers, previous_absent, recent_states, previous_end = 0, 0, 0, first - gap_before
    for track in range(first, first + min(count, MAX_TRACK_SPAN)):
        is_present = not coder.decoding and headers[num_headers, TRACK] == track
        previous_absent = code_bit(coder, C_ABSENT + previous_absent, 0 if is_present else 1)
        if previous_absent:
            continue
        if num_headers == n:
            break
        state = code_bit(coder, C_MOVING + recent_states, headers[num_headers, STATE])
        recent_states = ((recent_states << 1) | state) & 3
        begins, ends = np.int64(0), num_frames
        if track >= first_new and code_bit(coder, np.int64(C_BEGINS), 1 if headers[num_headers, BEGINS] else 0):
            begins = code_below(coder, headers[num_headers, BEGINS], num_frames)
        if code_bit(coder, np.int64(C_ENDS), 1 if headers[num_headers, ENDS] < num_frames else 0):
            ends = code_below(coder, headers[num_headers, ENDS], num_frames)
        (
            headers[num_headers, TRACK],
            headers[num_headers, STATE],
            headers[num_headers, BEGINS],
            headers[num_headers, ENDS],
        ) = track, state, begins, ends
        headers[num_headers, GAP_BEFORE], headers[num_headers, GAP_AFTER] = track - previous_end, 0
        previous_end = track + 1
        num_headers += 1
    if num_headers:
        headers[num_headers - 1, GAP_AFTER] = gap_after
    return num_headers


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _magnitude_context(magnitude):
    """Returns the context of a residual, given the magnitude of previously coded residuals."""
    octave = 0
    while magnitude >> octave and octave < NEIGHBOUR_CONTEXTS - 1:
        octave += 1
    return octave


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _code_interval(coder, low, span, num_bytes, start, size, bits):
    """Encodes or decodes one symbol, given its probability interval.

    The state of the range coder consists of `low`, `span` and `num_bytes`.

    Args:
        coder: Entropy coder of the packet.
        low: In an encoder, lower end of the range coder's interval. In a decoder, distance of the code value from this
            end.
        span: Size of the range coder's interval.
        num_bytes: Number of bytes written or read so far.
        start: Start of the symbol's probability interval, in units of `2**-bits`.
        size: Size of the symbol's probability interval, in units of `2**-bits`.
        bits: Number of bits of a probability.

    Returns:
        The new state: `low`, `span` and `num_bytes`.
    """
    # The state is passed as arguments and returned, so that it stays in registers.
    unit = span >> bits
    span = unit * size
    if coder.decoding:
        low = min(low - unit * start, span - 1)
        while span < BOTTOM:
            low <<= 8
            if num_bytes < len(coder.data):
                low |= np.int64(coder.data[num_bytes])
            num_bytes += 1
            span <<= 8
        return low, span, num_bytes
    low += unit * start
    if low >> TOP:
        low &= (ONE << TOP) - 1
        back = num_bytes - 1
        while coder.data[back] == 255:
            coder.data[back] = 0
            back -= 1
        coder.data[back] += 1
    while span < BOTTOM:
        coder.data[num_bytes] = low >> 40
        num_bytes += 1
        low = (low & LOW_MASK) << 8
        span <<= 8
    return low, span, num_bytes


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _code_bit(coder, low, span, num_bytes, context, bit):
    """Encodes or decodes a bit with an adaptive model.

    Args:
        coder: Entropy coder of the packet.
        low: State of the range coder, see `_code_interval`.
        span: State of the range coder.
        num_bytes: State of the range coder.
        context: Index of the adaptive model.
        bit: The bit; ignored by a decoder.

    Returns:
        The bit, and the new state: `low`, `span` and `num_bytes`.
    """
    p_zero = zero_probability(coder.models, context)
    if coder.decoding:
        bit = ONE if low >= p_zero * (span >> ADAPTIVE_BITS) else ZERO
    else:
        coder.bit_counts[context, bit] += 1
    adaptive_update(coder.models, context, bit)
    if bit:
        low, span, num_bytes = _code_interval(coder, low, span, num_bytes, p_zero, 65536 - p_zero, ADAPTIVE_BITS)
    else:
        low, span, num_bytes = _code_interval(coder, low, span, num_bytes, ZERO, p_zero, ADAPTIVE_BITS)
    return bit, low, span, num_bytes


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _code_raw(coder, low, span, num_bytes, value, bits):
    """Encodes or decodes an integer with equally probable bits.

    Args:
        coder: Entropy coder of the packet.
        low: State of the range coder, see `_code_interval`.
        span: State of the range coder.
        num_bytes: State of the range coder.
        value: The integer; ignored by a decoder.
        bits: Number of bits of the integer.

    Returns:
        The integer, and the new state: `low`, `span` and `num_bytes`.
    """
    number = ZERO
    while bits > 0:
        part_bits = min(bits, RAW_BITS)
        bits -= part_bits
        part = (value >> bits) & ((ONE << part_bits) - 1)
        if coder.decoding:
            part = min(low // (span >> part_bits), (ONE << part_bits) - 1)
        low, span, num_bytes = _code_interval(coder, low, span, num_bytes, part, ONE, part_bits)
        number = (number << part_bits) | part
    return number, low, span, num_bytes


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _code_coefficient(coder, low, span, num_bytes, kind, degree, neighbour_context, value):
    """Encodes or decodes the prediction residual of one motion coefficient of a track (Gaussian over time).

    Args:
        coder: Entropy coder of the packet.
        low: State of the range coder, see `_code_interval`.
        span: State of the range coder.
        num_bytes: State of the range coder.
        kind: Kind of motion (position, rotation, scale, opacity or colour); selects the context.
        degree: Degree of the coefficient's polynomial; selects the context.
        neighbour_context: Octave of the magnitude of neighbouring residuals; selects the context.
        value: The residual; ignored by a decoder.

    Returns:
        The residual, and the new state: `low`, `span` and `num_bytes`.
    """
    degree_context = kind * DEGREE_CONTEXTS + min(degree, DEGREE_CONTEXTS - 1)
    zero_context = np.int64(C_ZERO + degree_context * NEIGHBOUR_CONTEXTS + neighbour_context)
    is_nonzero, low, span, num_bytes = _code_bit(coder, low, span, num_bytes, zero_context, ONE if value else ZERO)
    if not is_nonzero:
        return ZERO, low, span, num_bytes
    magnitude, octave = abs(value), ZERO
    base = C_OCTAVE + (kind * NEIGHBOUR_CONTEXTS + neighbour_context) * OCTAVE_CONTEXTS
    while octave < MAX_OCTAVE:
        context, above = np.int64(base + min(octave, OCTAVE_CONTEXTS - 1)), ONE if magnitude >> (octave + 1) else ZERO
        above, low, span, num_bytes = _code_bit(coder, low, span, num_bytes, context, above)
        if not above:
            break
        octave += 1
    rest, low, span, num_bytes = _code_raw(coder, low, span, num_bytes, magnitude - (ONE << octave), octave)
    magnitude = min((ONE << octave) + rest, MAX_QUANTISED)
    negative = ONE if value < 0 else ZERO
    if coder.decoding:
        negative = ONE if low >= span >> ONE else ZERO
    low, span, num_bytes = _code_interval(coder, low, span, num_bytes, negative, ONE, ONE)
    return -magnitude if negative else magnitude, low, span, num_bytes


@njit(borrows=True, error_model="numpy")
@no_type_check
def code_motion(coder, headers, n, num_coefficients, quantised, num_frames, first_new):
    """Encodes or decodes the motion of a packet's n tracks (Gaussians over time).

    Args:
        coder: Entropy coder of the packet.
        headers: Headers of the tracks, int64 (n, fields), ascending by track index: input of an encoder, output of a
            decoder.
        n: Number of tracks in the packet.
        num_coefficients: For each kind of channel (position, rotation, scale, opacity, colour), number of polynomial
            coefficients coded per channel, int64 (kinds): input of an encoder, output of a decoder.
        quantised: Residuals of coefficients in quantisation steps, int32 (n, channels, frames): input of an encoder,
            output of a decoder. A decoder must be given an array of zeros.
        num_frames: Number of frames in the group, F.
        first_new: Index in the stream of the first track that begins in the group.
    """
    if coder.decoding:
        headers[:] = -1
    num_headers = _code_headers(coder, headers, n, num_frames, first_new)
    for kind in range(NUM_KINDS):
        num_coefficients[kind] = code_below(coder, num_coefficients[kind], num_frames + 1)
    previous_row, low, span, num_bytes = -1, coder.state[0], coder.state[1], coder.state[2]
    for i in range(num_headers):
        if headers[i, STATE] != MOVING:
            continue
        largest = np.int64(0)
        for c in range(NUM_CHANNELS):
            kind, largest_of_channel = KIND_OF[c], np.int64(0)
            is_first_of_kind = c == 0 or KIND_OF[c - 1] != kind
            if is_first_of_kind:
                largest = np.int64(0)
                if previous_row >= 0:
                    largest_of_channel = abs(np.int64(quantised[previous_row, c, 0]))
            for k in range(num_coefficients[kind]):
                expected_magnitude = max(largest_of_channel, largest)
                if not is_first_of_kind:
                    expected_magnitude = max(expected_magnitude, 2 * abs(np.int64(quantised[i, c - 1, k])))
                value = np.int64(quantised[i, c, k])
                value, low, span, num_bytes = _code_coefficient(
                    coder, low, span, num_bytes, kind, k, _magnitude_context(expected_magnitude), value
                )
                quantised[i, c, k] = value
                largest_of_channel = abs(value) if k == 0 and is_first_of_kind else max(largest_of_channel, abs(value))
            largest = max(largest, largest_of_channel)
        previous_row = i
    coder.state[0], coder.state[1], coder.state[2] = low, span, num_bytes
