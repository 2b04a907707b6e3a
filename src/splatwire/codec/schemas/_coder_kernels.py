"""Numba kernels that code one thing in either direction: what decides how it is coded is said once, for both ends.

A `Coder` carries everything that does not change from Gaussian to Gaussian. Encoding returns what it was given, and
counts contexts, from which the tables of the side information are made; decoding returns what it finds.
"""

from typing import Any, NamedTuple, no_type_check

import numpy as np

from splatwire.codec.schemas.gaussians.layout import EIGHTHS, MAX_RESIDUAL, NARROW_WEIGHT, WIDE
from splatwire.entropy.normal_kernels import decode_escape, decode_symbol, encode_escape, encode_symbol
from splatwire.entropy.range_kernels import (
    ONE,
    ZERO,
    decode_below,
    decode_bit,
    decode_bits,
    decode_raw,
    encode_below,
    encode_bit,
    encode_bits,
    encode_raw,
)
from splatwire.entropy.tables import MEAN_BITS, NUM_SCALES
from splatwire.ops.compiled import njit

WEIGHT = np.int64(NARROW_WEIGHT)
DECODING, ENCODING = np.bool_(True), np.bool_(False)


class Coder(NamedTuple):
    """State of one packet's coder and the tables of its stream.

    Attributes:
        decoding: Whether bytes are read.
        data: uint8, bytes of all packets.
        end: Where this packet's bytes end.
        state: int64 (3), of the range coder.
        models: int64 (contexts, 2), adaptive models of this packet.
        bits: int64 (contexts, 2), how often each bit was coded.
        scales: int64 (streams, spreads, seconds), narrow scale of each residual.
        residuals: int64 (streams, spreads, seconds, 2), how often, and sum of magnitudes.
        inverses: Table of the range coder, as the next two.
        widths: See `splatwire.entropy.coder.tables`.
        normal: See there.
    """

    decoding: Any
    data: Any
    end: Any
    state: Any
    models: Any
    bits: Any
    scales: Any
    residuals: Any
    inverses: Any
    widths: Any
    normal: Any


@njit(error_model="numpy")
@no_type_check
def new_coder(decoding, data, end, models, statistics, tables):
    """A coder of a packet; its state is to be started."""
    bits, residuals = statistics
    scales, inverses, widths, normal = tables
    return Coder(decoding, data, end, np.empty(3, np.int64), models, bits, scales, residuals, inverses, widths, normal)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def code_bit(coder, context, bit):
    """Codes a bit with an adaptive model."""
    if coder.decoding:
        return decode_bit(coder.data, coder.end, coder.state, coder.models, context)
    encode_bit(coder.data, coder.state, coder.models, context, bit)
    coder.bits[context, bit] += 1
    return bit


@njit(borrows=True, error_model="numpy")
@no_type_check
def code_flag(coder, bit):
    """Codes a bit that is as likely one as zero."""
    if coder.decoding:
        return decode_raw(coder.data, coder.end, coder.state)
    encode_raw(coder.data, coder.state, bit)
    return bit


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def code_raw(coder, value, bits):
    """Codes up to 63 equiprobable bits, the high ones first."""
    if coder.decoding:
        return decode_bits(coder.data, coder.end, coder.state, bits)
    encode_bits(coder.data, coder.state, value, bits)
    return value & ((ONE << bits) - ONE)


@njit(borrows=True, error_model="numpy")
@no_type_check
def code_below(coder, value, count):
    """Codes a number below `count`, at most 2**16, all alike probable."""
    if coder.decoding:
        return decode_below(coder.data, coder.end, coder.state, count)
    encode_below(coder.data, coder.state, value, count)
    return value


@njit(borrows=True, error_model="numpy")
@no_type_check
def code_escape(coder, excess):
    """Codes a number >= 0 in Elias gamma."""
    if coder.decoding:
        return min(decode_escape(coder.data, coder.end, coder.state), MAX_RESIDUAL)
    encode_escape(coder.data, coder.state, excess)
    return excess


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def code_residual(coder, stream, spread, second, residual, shift):
    """Codes a residual in steps of `1 << shift` as a mixture of two normals of mean 0; returns the decoded residual."""
    return _code_steps(coder, stream, spread, second, (residual + ((1 << shift) >> 1)) >> shift, ZERO) << shift


@njit(borrows=True, error_model="numpy")
@no_type_check
def code_value(coder, stream, spread, second, mean, value, shift, absolute):
    """Codes a value that is expected to be `mean`, in steps of `1 << shift`; returns it, and its residual in steps.

    It becomes a multiple of the step, whatever the mean is, if `absolute`; otherwise it is whole steps from the mean.
    """
    if not absolute:
        residual = code_residual(coder, stream, spread, second, value - mean, shift)
        return mean + residual, residual >> shift
    half = (1 << shift) >> 1
    eighths = ((mean << EIGHTHS) + half) >> shift
    near = (eighths + (1 << (EIGHTHS - 1))) >> EIGHTHS
    rest = (eighths - (near << EIGHTHS)) << (MEAN_BITS - EIGHTHS)
    steps = _code_steps(coder, stream, spread, second, ((value + half) >> shift) - near, rest)
    return (near + steps) << shift, steps


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _code_steps(coder, stream, spread, second, q, mean):
    """Codes an integer as a mixture of two normals of this mean, `MEAN_BITS` fractional bits."""
    scale = coder.scales[stream, spread, second]
    wide = min(scale + WIDE, NUM_SCALES - 1)
    if coder.decoding:
        q = decode_symbol(
            coder.data, coder.end, coder.state, mean, scale, mean, wide, WEIGHT,
            coder.inverses, coder.widths, coder.normal,
        )  # fmt: skip
        q = min(max(q, -MAX_RESIDUAL), MAX_RESIDUAL)
    else:
        q = min(max(q, -MAX_RESIDUAL), MAX_RESIDUAL)
        encode_symbol(
            coder.data, coder.state, q, mean, scale, mean, wide, WEIGHT, coder.inverses, coder.widths, coder.normal
        )
        coder.residuals[stream, spread, second, 0] += 1
        coder.residuals[stream, spread, second, 1] += abs(q)
    return q
