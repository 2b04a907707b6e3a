"""Numba kernels that code the importance tier of every element."""

from typing import no_type_check

import numpy as np

from splatwire.entropy.range_kernels import ZERO, decode_bit, decoder_start, encode_bit, encoder_finish, encoder_start
from splatwire.ops.compiled import njit

COUNTS = 16
"""Quantisation levels of the decaying average of elements that are at least as important."""
STATES = 4 * COUNTS
"""Number of contexts of a tier's bit: levels of the decaying average, times four for this bit in the last two elements.
"""


@njit(borrows=True)
@no_type_check
def tier_context(tier, count, recent):
    """Returns the index of the adaptive model for one bit of an element's importance tier, which is coded in unary.

    The bit is 1 if the element is in tier `tier`, and 0 if it is in a less important tier.

    Args:
        tier: Index of the tier, 0 for the most important.
        count: Share of the preceding elements that are in this tier or a more important one: a decaying average, in
            units of 2**-16.
        recent: Two bits for the last two elements, 0 to 3: a bit is 1 if the element is in this tier or a more
            important one. Bit 0 is for the last element.
    """
    # Contexts distinguish small shares finely.
    step, value = 0, count >> 4
    while value and step < COUNTS - 1:
        value = value * 5 // 8
        step += 1
    return tier * STATES + 4 * step + recent


@njit(borrows=True)
@no_type_check
def add_to_statistics(counts, recents, tier, important):
    """Adds an element that was just coded to the statistics of one importance tier.

    The statistics select the adaptive models for the next elements (see `tier_context`). An element is at least as
    important as a tier if it is in this tier or in a more important one.

    Args:
        counts: For each tier, share of the coded elements that are at least as important as the tier: a decaying
            average, in units of 2**-16. Entry `tier` is changed in place.
        recents: For each tier, two bits for the last two elements, 0 to 3: a bit is 1 if the element is at least as
            important as the tier. Bit 0 is for the last element. Entry `tier` is changed in place.
        tier: Index of the tier, 0 for the most important.
        important: True if the element is at least as important as the tier.
    """
    counts[tier] += ((65535 if important else 0) - counts[tier]) >> 3
    recents[tier] = (2 * recents[tier] + (1 if important else 0)) & 3


@njit(nogil=True)
@no_type_check
def encode_tiers(tiers, num_tiers, models, buffer):
    """Encodes the importance tier of each element in unary.

    Args:
        tiers: Tier of each element, 0 for the most important.
        num_tiers: Number of tiers.
        models: Adaptive bit models, changed in place.
        buffer: Output bytes.

    Returns:
        Number of bytes written to `buffer`.
    """
    # For each tier but the last, one bit indicates whether the element is in this tier. The bits of an element end with
    # the first 1.
    state = np.empty(3, np.int64)
    encoder_start(state)
    counts, recents = np.zeros(num_tiers, np.int64), np.zeros(num_tiers, np.int64)
    for n in range(len(tiers)):
        for tier in range(num_tiers - 1):
            if tiers[n] >= tier:
                bit = 1 if tiers[n] == tier else 0
                encode_bit(buffer, state, models, tier_context(tier, counts[tier], recents[tier]), bit)
            add_to_statistics(counts, recents, tier, tiers[n] <= tier)
    return encoder_finish(buffer, state)


@njit(nogil=True)
@no_type_check
def decode_tiers(data, num_tiers, models, tiers):
    """Decodes the importance tiers written by `encode_tiers`.

    Args:
        data: Input bytes.
        num_tiers: Number of tiers.
        models: Adaptive bit models, changed in place.
        tiers: Output: importance tier of each element, 0 for the most important.
    """
    state = np.empty(3, np.int64)
    decoder_start(data, ZERO, len(data), state)
    counts, recents = np.zeros(num_tiers, np.int64), np.zeros(num_tiers, np.int64)
    for n in range(len(tiers)):
        tiers[n] = num_tiers - 1
        for tier in range(num_tiers - 1):
            context = tier_context(tier, counts[tier], recents[tier])
            if tiers[n] == num_tiers - 1 and decode_bit(data, len(data), state, models, context):
                tiers[n] = tier
            add_to_statistics(counts, recents, tier, tiers[n] <= tier)
