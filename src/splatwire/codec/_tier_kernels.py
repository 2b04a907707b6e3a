"""Numba kernels that code the tier of every anchor."""

from typing import no_type_check

import numpy as np

from splatwire.entropy.range_kernels import ZERO, decode_bit, decoder_start, encode_bit, encoder_finish, encoder_start
from splatwire.ops.compiled import njit

COUNTS = 16
"""Steps of the decaying count of anchors that are at least as important."""
STATES = 4 * COUNTS
"""Contexts of a tier's bit: that count, and the same bit of the two anchors before."""


@njit(borrows=True)
@no_type_check
def tier_context(tier, count, recent):
    """Context of a bit: the count, 0 to 1 in 16 bits, is quantised finely near zero."""
    step, value = 0, count >> 4
    while value and step < COUNTS - 1:
        value = value * 5 // 8
        step += 1
    return tier * STATES + 4 * step + recent


@njit(borrows=True)
@no_type_check
def remember(counts, recents, tier, important):
    """Updates what later anchors know of this one."""
    counts[tier] += ((65535 if important else 0) - counts[tier]) >> 3
    recents[tier] = (2 * recents[tier] + (1 if important else 0)) & 3


@njit(nogil=True)
@no_type_check
def encode_tiers(tiers, num_tiers, models, buffer):
    """Codes tiers; returns the number of bytes. Each is a run of bits: is it tier 0, is it tier 1, ..."""
    state = np.empty(3, np.int64)
    encoder_start(state)
    counts, recents = np.zeros(num_tiers, np.int64), np.zeros(num_tiers, np.int64)
    for n in range(len(tiers)):
        for tier in range(num_tiers - 1):
            if tiers[n] >= tier:
                bit = 1 if tiers[n] == tier else 0
                encode_bit(buffer, state, models, tier_context(tier, counts[tier], recents[tier]), bit)
            remember(counts, recents, tier, tiers[n] <= tier)
    return encoder_finish(buffer, state)


@njit(nogil=True)
@no_type_check
def decode_tiers(data, num_tiers, models, tiers):
    """Inverse of `encode_tiers`; any bytes give tiers below `num_tiers`."""
    state = np.empty(3, np.int64)
    decoder_start(data, ZERO, len(data), state)
    counts, recents = np.zeros(num_tiers, np.int64), np.zeros(num_tiers, np.int64)
    for n in range(len(tiers)):
        tiers[n] = num_tiers - 1
        for tier in range(num_tiers - 1):
            context = tier_context(tier, counts[tier], recents[tier])
            if tiers[n] == num_tiers - 1 and decode_bit(data, len(data), state, models, context):
                tiers[n] = tier
            remember(counts, recents, tier, tiers[n] <= tier)
