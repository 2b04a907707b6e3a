"""Numba kernels that encode or decode one symbol; a flag of the `Coder` selects the direction.

When encoding, a kernel encodes the value that is passed to it and returns this value. When decoding, it ignores the
value that is passed and returns the decoded value.
"""
# One kernel for both directions guarantees that encoder and decoder choose the same contexts and distributions. When
# encoding, a kernel also counts the context used; the tables of the side information are fitted to these counts.

from typing import Any, NamedTuple, no_type_check

import numpy as np

from splatwire.codec._residual_kernels import (
    FIRST_BOUND,
    GUESS_AT,
    GUESS_BITS,
    MAX_MAGNITUDE,
    NUM_MEANS,
    SHIFT,
    STRIDE,
    WEIGHT,
)
from splatwire.codec.gaussians.layout import (
    MAX_RESIDUAL,
    MEAN_FRACTION_BITS,
    NUM_DEVIATION_CONTEXTS,
    NUM_MAGNITUDE_CONTEXTS,
    WIDE_SCALE_OFFSET,
)
from splatwire.entropy.normal_kernels import (
    ESCAPE,
    SYMBOL_BITS,
    TOTAL,
    cumulative,
    encode_escape,
    encode_symbol,
)
from splatwire.entropy.range_kernels import ONE, ZERO, decode_target
from splatwire.entropy.tables import MEAN_BITS, NUM_SCALES
from splatwire.entropy.word_kernels import (
    adaptive_bit,
    advance,
    escaped,
    number_below,
    raw_bit,
    raw_bits,
    write_below,
    write_bit,
    write_interval,
    write_raw,
)
from splatwire.ops.compiled import njit

DECODING, ENCODING = np.bool_(True), np.bool_(False)


class Coder(NamedTuple):
    """Entropy coder of one packet: range coder, adaptive models, and the probability tables of the stream.

    A prediction residual is coded with the probability distribution of its context. A context has three indices: kind
    of value, deviation context, and magnitude context (see `code_value`). The standard deviations of all distributions
    are from a fixed table (`entropy.tables`).

    Attributes:
        decoding: True when decoding, False when encoding.
        data: Bytes of the packet, or the output buffer, uint8.
        words: Bytes of the packet as overlapping integers (see `words_of`), which the decoder reads, int64.
        state: State of the range coder, int64 (3).
        models: Adaptive bit models of this packet, int64 (contexts, 2).
        bit_counts: Number of zeros and of ones coded so far with each adaptive bit model, int64 (contexts, 2).
        scale_indices: Index of the standard deviation of each residual context, uint16 (contexts).
        distributions: For each standard deviation, its range of residuals and the positions of its entries in `bounds`
            and `guesses`, int64 (standard deviations, 6); see `residual_distributions`.
        bounds: Starts of the probability intervals of residuals, int32.
        guesses: Index of the probability interval at which a decoder starts its search for a residual, uint16.
        residual_statistics: Number of residuals coded per context, and sum of their magnitudes (last axis), int64.
        inverse_scales: Reciprocal of each standard deviation in the fixed table.
        widths: For each of these standard deviations, the largest magnitude of a residual that has a probability
            interval. Larger residuals are coded with an escape code.
        normal_cdf: Table of the normal cumulative distribution function.
    """

    decoding: Any
    data: Any
    words: Any
    state: Any
    models: Any
    bit_counts: Any
    scale_indices: Any
    distributions: Any
    bounds: Any
    guesses: Any
    residual_statistics: Any
    inverse_scales: Any
    widths: Any
    normal_cdf: Any


@njit(error_model="numpy", forceinline=True)
@no_type_check
def new_coder(decoding, data, words, models, statistics, tables):
    """Creates the entropy coder of a packet, without initialising the state of the range coder.

    Args:
        decoding: True for a decoder.
        data: Bytes of the packet, or the output buffer, uint8.
        words: The bytes of the packet as overlapping integers, from `words_of`, for decoding.
        models: Initial adaptive bit models, int64 (contexts, 2).
        statistics: The two counters `bit_counts` and `residual_statistics` of `Coder`.
        tables: The seven tables `scale_indices`, `distributions`, `bounds`, `guesses`, `inverse_scales`, `widths` and
            `normal_cdf` of `Coder`.
    """
    bit_counts, residual_statistics = statistics
    scale_indices, distributions, bounds, guesses, inverse_scales, widths, normal_cdf = tables
    state = np.empty(3, np.int64)
    return Coder(
        decoding, data, words, state, models, bit_counts, scale_indices, distributions, bounds, guesses,
        residual_statistics, inverse_scales, widths, normal_cdf,
    )  # fmt: skip


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def code_bit(coder, context, bit):
    """Encodes or decodes a bit with the adaptive model of a context; returns the bit. A decoder ignores `bit`."""
    if coder.decoding:
        return adaptive_bit(coder.words, coder.state, coder.models, context)
    write_bit(coder.data, coder.state, coder.models, context, bit)
    coder.bit_counts[context, bit] += 1
    return bit


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def code_flag(coder, bit):
    """Encodes or decodes a bit with equal probabilities for 0 and 1; returns the bit. A decoder ignores `bit`."""
    if coder.decoding:
        return raw_bit(coder.words, coder.state)
    write_interval(coder.data, coder.state, bit, ONE, ONE)
    return bit


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def code_raw(coder, value, bits):
    """Encodes or decodes an integer of `bits` bits with equal probabilities for all values; returns the integer.

    `bits` is at most 63. A decoder ignores `value`.
    """
    if coder.decoding:
        return raw_bits(coder.words, coder.state, bits)
    write_raw(coder.data, coder.state, value, bits)
    return value & ((ONE << bits) - ONE)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def code_below(coder, value, count):
    """Encodes or decodes a number from 0 to `count - 1`, all equally probable; returns the number.

    `count` is at most 2**16. A decoder ignores `value`.
    """
    if coder.decoding:
        return number_below(coder.words, coder.state, count)
    write_below(coder.data, coder.state, value, count)
    return value


@njit(borrows=True, error_model="numpy")
@no_type_check
def code_escape(coder, excess):
    """Encodes or decodes a non-negative integer in Elias gamma code; returns the integer.

    Args:
        coder: Entropy coder.
        excess: The integer; ignored by a decoder. A decoder clips its result to `MAX_RESIDUAL`.
    """
    if coder.decoding:
        return min(escaped(coder.words, coder.state), MAX_RESIDUAL)
    encode_escape(coder.data, coder.state, excess)
    return excess


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def code_value(coder, kind, deviation_context, magnitude_context, mean, value, shift, absolute):
    """Encodes or decodes a quantised integer relative to a prediction.

    Args:
        coder: Entropy coder.
        kind: Kind of value: first index of the context.
        deviation_context: Second index of the context. It grows with the deviation of neighbouring Gaussians' values
            from their mean.
        magnitude_context: Third index of the context. For opacity and the largest scale, it is log2 of the quantisation
            step. For all other kinds of value, it grows with the mean magnitude of earlier residuals.
        mean: The prediction.
        value: The value; only used by an encoder.
        shift: log2 of the quantisation step: the step is `1 << shift`.
        absolute: True to quantise the value; False, in side information of version 2, to quantise its difference from
            the prediction.

    Returns:
        The decoded value, and its residual in steps.
    """
    half_step = (1 << shift) >> 1
    if not absolute:
        steps = _code_residual(
            coder, kind, deviation_context, magnitude_context, (value - mean + half_step) >> shift, ZERO
        )
        return mean + (steps << shift), steps
    scaled_mean = ((mean << MEAN_FRACTION_BITS) + half_step) >> shift  # in steps, with fractional bits
    mean_steps = (scaled_mean + (1 << (MEAN_FRACTION_BITS - 1))) >> MEAN_FRACTION_BITS
    mean_fraction = scaled_mean - (mean_steps << MEAN_FRACTION_BITS)
    residual = ((value + half_step) >> shift) - mean_steps
    steps = _code_residual(coder, kind, deviation_context, magnitude_context, residual, mean_fraction)
    return (mean_steps + steps) << shift, steps


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _code_residual(coder, kind, deviation_context, magnitude_context, residual, mean_fraction):
    """Encodes or decodes a prediction residual, in quantisation steps.

    Args:
        coder: Entropy coder.
        kind: Kind of value: first index of the context.
        deviation_context: Second index of the context (see `code_value`).
        magnitude_context: Third index of the context (see `code_value`).
        residual: The residual; only used by an encoder.
        mean_fraction: Mean of the residual's distribution, in eighths of a step, -4 to 3. It is the predicted mean
            minus the nearest whole number of steps.

    Returns:
        The residual.
    """
    context = (kind * NUM_DEVIATION_CONTEXTS + deviation_context) * NUM_MAGNITUDE_CONTEXTS + magnitude_context
    scale = np.int64(coder.scale_indices[context])
    table_row, mean_index = coder.distributions[scale], mean_fraction + (NUM_MEANS >> 1)
    max_magnitude, first = table_row[MAX_MAGNITUDE], table_row[FIRST_BOUND] + mean_index * table_row[STRIDE]
    if coder.decoding:
        target = decode_target(coder.state, SYMBOL_BITS)
        if target >= TOTAL - ESCAPE:
            residual = _decode_escape(coder.words, coder.state, max_magnitude)
        else:
            bits = table_row[GUESS_BITS]
            guess = table_row[GUESS_AT] + (mean_index << bits) + (target >> (SYMBOL_BITS - bits))
            index = first + np.int64(coder.guesses[guess])
            start, after = np.int64(coder.bounds[index]), np.int64(coder.bounds[index + 1])
            while after <= target:
                index += 1
                start, after = after, np.int64(coder.bounds[index + 1])
            if table_row[SHIFT]:
                residual = _decode_wide(coder, scale, index - first, start, after, target, mean_fraction)
            else:
                advance(coder.words, coder.state, start, after - start, SYMBOL_BITS)
                residual = index - first - max_magnitude
    elif table_row[SHIFT] == 0 and -max_magnitude <= residual <= max_magnitude:
        start = np.int64(coder.bounds[first + max_magnitude + residual])
        size = np.int64(coder.bounds[first + max_magnitude + residual + 1]) - start
        write_interval(coder.data, coder.state, start, size, SYMBOL_BITS)
    else:
        residual = _encode_wide(coder, scale, residual, mean_fraction)
    if not coder.decoding:
        coder.residual_statistics[kind, deviation_context, magnitude_context, 0] += 1
        coder.residual_statistics[kind, deviation_context, magnitude_context, 1] += abs(residual)
    return residual


@njit(borrows=True, error_model="numpy")
@no_type_check
def _decode_escape(words, state, max_magnitude):
    """Decodes a residual from an escape code, which is used for magnitudes that exceed the probability tables.

    Args:
        words: The bytes of the packet, from `words_of`.
        state: State of the range decoder, changed in place.
        max_magnitude: Largest magnitude in the probability tables.

    Returns:
        The residual in quantisation steps.
    """
    # The code is a sign, and the excess over `max_magnitude` in Elias gamma code.
    advance(words, state, TOTAL - ESCAPE, ESCAPE, SYMBOL_BITS)
    above = raw_bit(words, state)
    outside = max_magnitude + 1 + escaped(words, state)
    return min(outside, MAX_RESIDUAL) if above else max(-outside, -MAX_RESIDUAL)


@njit(borrows=True, error_model="numpy")
@no_type_check
def _decode_wide(coder, scale, index, start, after, target, mean_fraction):
    """Decodes a residual under a wide distribution.

    The probability table of a wide distribution contains the starts of only every 2^k-th interval. This function
    computes the other starts.

    Args:
        coder: Entropy coder.
        scale: Index of the distribution's (smaller) standard deviation.
        index: Index of the last table entry that does not exceed `target`.
        start: Interval start in this table entry.
        after: Interval start in the next table entry.
        target: Position on the probability axis that the range decoder has read, from `start` to `after` (exclusive).
        mean_fraction: Mean of the distribution, in eighths of a quantisation step, -4 to 3.

    Returns:
        The residual in quantisation steps.
    """
    # Tables of wide distributions contain only every `2**k`-th start of a probability interval. The search begins with
    # linear interpolation between the tabulated starts, because the density is nearly constant there.
    max_magnitude, shift, mean = (
        coder.distributions[scale, MAX_MAGNITUDE],
        coder.distributions[scale, SHIFT],
        mean_fraction << (MEAN_BITS - MEAN_FRACTION_BITS),
    )
    narrow, wide = coder.inverse_scales[scale], coder.inverse_scales[min(scale + WIDE_SCALE_OFFSET, NUM_SCALES - 1)]
    steps = np.int64(np.float64((target - start) << shift) / np.float64(after - start))
    symbol = (index << shift) + steps - max_magnitude
    low = _interval_start(coder, symbol, max_magnitude, mean, narrow, wide)
    while low > target:
        symbol -= 1
        low = _interval_start(coder, symbol, max_magnitude, mean, narrow, wide)
    high = _interval_start(coder, symbol + 1, max_magnitude, mean, narrow, wide)
    while high <= target:
        symbol, low = symbol + 1, high
        high = _interval_start(coder, symbol + 1, max_magnitude, mean, narrow, wide)
    advance(coder.words, coder.state, low, high - low, SYMBOL_BITS)
    return symbol


@njit(borrows=True, error_model="numpy")
@no_type_check
def _interval_start(coder, symbol, max_magnitude, mean, narrow, wide):
    """Computes where the probability interval of a residual starts, if this start is not in the tables.

    Args:
        coder: Entropy coder.
        symbol: The residual, from `-max_magnitude` to `max_magnitude`; `max_magnitude + 1` for the end of the last
            interval.
        max_magnitude: Largest magnitude of a residual with a probability interval.
        mean: Mean of the distribution, `MEAN_BITS` fractional bits. The distribution is a mixture of two normals.
        narrow: Reciprocal of the smaller of the two standard deviations.
        wide: Reciprocal of the larger of the two standard deviations.

    Returns:
        The start, in units of 2**-24.
    """
    # Not inlined, because the callers call it several times.
    return cumulative(symbol, -max_magnitude, max_magnitude, mean, narrow, mean, wide, WEIGHT, coder.normal_cdf)


@njit(borrows=True, error_model="numpy")
@no_type_check
def _encode_wide(coder, scale, residual, mean_fraction):
    """Encodes a residual whose interval is not tabulated: a very large residual, or one with a wide distribution.

    Args:
        coder: Entropy coder.
        scale: Index of the distribution's (smaller) standard deviation.
        residual: The residual in quantisation steps.
        mean_fraction: Mean of the distribution, in eighths of a step, -4 to 3.

    Returns:
        The encoded residual: `residual`, clipped to magnitudes of at most `MAX_RESIDUAL`.
    """
    # The tables omit very large residuals, and most residuals of wide distributions.
    mean = mean_fraction << (MEAN_BITS - MEAN_FRACTION_BITS)
    wide = min(scale + WIDE_SCALE_OFFSET, NUM_SCALES - 1)
    residual = min(max(residual, -MAX_RESIDUAL), MAX_RESIDUAL)
    encode_symbol(
        coder.data,
        coder.state,
        residual,
        mean,
        scale,
        mean,
        wide,
        WEIGHT,
        coder.inverse_scales,
        coder.widths,
        coder.normal_cdf,
    )
    return residual
