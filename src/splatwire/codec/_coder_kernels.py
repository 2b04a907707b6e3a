"""Numba kernels that encode or decode one symbol; a flag of the `Coder` selects the direction.

One kernel for both directions guarantees that encoder and decoder choose the same contexts and distributions.

A `Coder` contains everything that is constant over the Gaussians of a packet. When encoding, a kernel encodes the value
that is passed to it and returns this value. It also counts the context used; the tables of the side information are
fitted to these counts. When decoding, a kernel ignores the value that is passed and returns the decoded value.
"""

from typing import Any, NamedTuple, no_type_check

import numpy as np

from splatwire.codec._residual_kernels import (
    AT,
    GUESS_SHIFT,
    HALF,
    NUM_GUESSES,
    NUM_MEANS,
    SCALE,
    STRIDE,
    WEIGHT,
)
from splatwire.codec.gaussians.layout import EIGHTHS, MAX_RESIDUAL, SECONDS, SPREADS, WIDE
from splatwire.entropy.normal_kernels import (
    ESCAPE,
    SYMBOL_BITS,
    TOTAL,
    decode_escape,
    decode_symbol,
    encode_escape,
    encode_symbol,
)
from splatwire.entropy.range_kernels import (
    ONE,
    ZERO,
    decode_advance,
    decode_below,
    decode_bit,
    decode_bits,
    decode_raw,
    decode_target,
    encode_below,
    encode_bit,
    encode_bits,
    encode_interval,
    encode_raw,
)
from splatwire.entropy.tables import MEAN_BITS, NUM_SCALES
from splatwire.ops.compiled import njit

DECODING, ENCODING = np.bool_(True), np.bool_(False)


class Coder(NamedTuple):
    """State of the entropy coder of one packet, and the tables of its stream.

    Residuals are differences of values from their prediction. The context of a residual is a triple: kind of value
    (`stream`, see `gaussians.layout.STREAMS`), class of the deviation of the neighbours (`spread`), and class of the
    quantisation step or of the preceding residuals (`second`).

    Attributes:
        decoding: True when decoding, False when encoding.
        data: uint8, bytes of all packets, or the output buffer.
        end: End of this packet's bytes.
        state: int64 (3), state of the range coder.
        models: int64 (contexts, 2), adaptive models of this packet.
        bits: int64 (contexts, 2), number of zeros and ones coded per context.
        windows: int64 (streams * spreads * seconds, 4), distribution of each context of residuals, see
            `residual_windows`.
        entries: int32, tables of these distributions.
        residuals: int64 (streams, spreads, seconds, 2), number of residuals and sum of their magnitudes.
        inverses: Reciprocals of the standard deviations, by scale index.
        widths: Half widths of the windows of directly coded symbols, by scale index.
        normal: Table of the normal cumulative distribution function.
    """

    decoding: Any
    data: Any
    end: Any
    state: Any
    models: Any
    bits: Any
    windows: Any
    entries: Any
    residuals: Any
    inverses: Any
    widths: Any
    normal: Any


@njit(error_model="numpy")
@no_type_check
def new_coder(decoding, data, end, models, statistics, tables):
    """Creates the coder of a packet; the caller then initialises the state of its range coder.

    Args:
        decoding: True for a decoder.
        data: Bytes of all packets, or the output buffer, uint8.
        end: End of the packet's bytes.
        models: Initial adaptive bit models, int64 (contexts, 2).
        statistics: Counters that become the attributes `bits` and `residuals` of the coder.
        tables: Tables that become the attributes `windows`, `entries`, `inverses`, `widths` and `normal`.
    """
    bits, residuals = statistics
    windows, entries, inverses, widths, normal = tables
    state = np.empty(3, np.int64)
    return Coder(
        decoding, data, end, state, models, bits, windows, entries, residuals, inverses, widths, normal
    )  # fmt: skip


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def code_bit(coder, context, bit):
    """Encodes or decodes a bit with the adaptive model of a context."""
    if coder.decoding:
        return decode_bit(coder.data, coder.end, coder.state, coder.models, context)
    encode_bit(coder.data, coder.state, coder.models, context, bit)
    coder.bits[context, bit] += 1
    return bit


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def code_flag(coder, bit):
    """Encodes or decodes a bit with equal probabilities for 0 and 1."""
    if coder.decoding:
        return decode_raw(coder.data, coder.end, coder.state)
    encode_raw(coder.data, coder.state, bit)
    return bit


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def code_raw(coder, value, bits):
    """Encodes or decodes up to 63 bits with equal probabilities, most significant first."""
    if coder.decoding:
        return decode_bits(coder.data, coder.end, coder.state, bits)
    encode_bits(coder.data, coder.state, value, bits)
    return value & ((ONE << bits) - ONE)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def code_below(coder, value, count):
    """Encodes or decodes a number from 0 to `count - 1` with equal probabilities; `count` is at most 2**16."""
    if coder.decoding:
        return decode_below(coder.data, coder.end, coder.state, count)
    encode_below(coder.data, coder.state, value, count)
    return value


@njit(borrows=True, error_model="numpy")
@no_type_check
def code_escape(coder, excess):
    """Encodes or decodes a non-negative number of unknown magnitude in Elias gamma code."""
    if coder.decoding:
        return min(decode_escape(coder.data, coder.end, coder.state), MAX_RESIDUAL)
    encode_escape(coder.data, coder.state, excess)
    return excess


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def code_value(coder, stream, spread, second, mean, value, shift, absolute):
    """Encodes or decodes a value as the difference from its prediction, in quantisation steps of `1 << shift`.

    Args:
        coder: Entropy coder.
        stream: Kind of value, part of the context (see `Coder`).
        spread: Class of the deviation of the neighbours, part of the context.
        second: Class of the step or of the preceding residuals, part of the context.
        mean: Predicted value.
        value: The value; only used by an encoder.
        shift: log2 of the quantisation step.
        absolute: True to decode a multiple of the step. False to decode a value that differs from `mean` by a multiple
            of the step.

    Returns:
        The decoded value, and its residual in steps.
    """
    half = (1 << shift) >> 1
    if not absolute:
        steps = _code_steps(coder, stream, spread, second, (value - mean + half) >> shift, ZERO)
        return mean + (steps << shift), steps
    eighths = ((mean << EIGHTHS) + half) >> shift
    near = (eighths + (1 << (EIGHTHS - 1))) >> EIGHTHS
    steps = _code_steps(
        coder, stream, spread, second, ((value + half) >> shift) - near, eighths - (near << EIGHTHS)
    )  # fmt: skip
    return (near + steps) << shift, steps


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _code_steps(coder, stream, spread, second, q, eighths):
    """Encodes or decodes a residual in quantisation steps under the mixture distribution of its context.

    Args:
        coder: Entropy coder.
        stream: Kind of value, part of the context (see `Coder`).
        spread: Class of the deviation of the neighbours, part of the context.
        second: Class of the step or of the preceding residuals, part of the context.
        q: The residual; only used by an encoder.
        eighths: Common mean of the two normals of the mixture, in eighths of a step, -4 to 3.

    Returns:
        The residual.
    """
    window = coder.windows[(stream * SPREADS + spread) * SECONDS + second]
    half = window[HALF]
    if window[AT] < 0:
        q = _code_wide(coder, window, q, eighths)
    else:
        bounds = window[AT] + (eighths + (NUM_MEANS >> 1)) * window[STRIDE] + NUM_GUESSES
        if coder.decoding:
            target = decode_target(coder.state, SYMBOL_BITS)
            if target >= TOTAL - ESCAPE:
                q = _decode_outside(coder.data, coder.end, coder.state, half)
            else:
                place = bounds + np.int64(coder.entries[bounds - NUM_GUESSES + (target >> GUESS_SHIFT)])
                start, next_start = np.int64(coder.entries[place]), np.int64(coder.entries[place + 1])
                while next_start <= target:
                    place += 1
                    start, next_start = next_start, np.int64(coder.entries[place + 1])
                decode_advance(coder.data, coder.end, coder.state, start, next_start - start, SYMBOL_BITS)
                q = place - bounds - half
        elif -half <= q <= half:
            start = np.int64(coder.entries[bounds + half + q])
            size = np.int64(coder.entries[bounds + half + q + 1]) - start
            encode_interval(coder.data, coder.state, start, size, SYMBOL_BITS)
        else:
            q = _code_wide(coder, window, q, eighths)
    if not coder.decoding:
        coder.residuals[stream, spread, second, 0] += 1
        coder.residuals[stream, spread, second, 1] += abs(q)
    return q


@njit(borrows=True, error_model="numpy")
@no_type_check
def _decode_outside(data, end, state, half):
    """Decodes a residual whose magnitude exceeds `half`, which is coded as a sign and an Elias gamma code."""
    decode_advance(data, end, state, TOTAL - ESCAPE, ESCAPE, SYMBOL_BITS)
    above = decode_raw(data, end, state)
    outside = half + 1 + decode_escape(data, end, state)
    return min(outside, MAX_RESIDUAL) if above else max(-outside, -MAX_RESIDUAL)


@njit(borrows=True, error_model="numpy")
@no_type_check
def _code_wide(coder, window, q, eighths):
    """Encodes or decodes a residual without the tables of `residual_windows`.

    This is needed for mixtures with many symbols, which are not tabulated. An encoder also needs it for residuals
    outside the window of a tabulated mixture.

    Args:
        coder: Entropy coder.
        window: The context's row of `Coder.windows`.
        q: The residual in quantisation steps; only used by an encoder.
        eighths: Mean of the mixture, in eighths of a step.
    """
    scale, mean = window[SCALE], eighths << (MEAN_BITS - EIGHTHS)
    wide = min(scale + WIDE, NUM_SCALES - 1)
    if coder.decoding:
        q = decode_symbol(
            coder.data, coder.end, coder.state, mean, scale, mean, wide, WEIGHT,
            coder.inverses, coder.widths, coder.normal,
        )  # fmt: skip
        return min(max(q, -MAX_RESIDUAL), MAX_RESIDUAL)
    q = min(max(q, -MAX_RESIDUAL), MAX_RESIDUAL)
    encode_symbol(
        coder.data, coder.state, q, mean, scale, mean, wide, WEIGHT, coder.inverses, coder.widths, coder.normal
    )
    return q
