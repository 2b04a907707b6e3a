"""Numba kernels that tabulate the distributions of residuals, so that coding a symbol needs two table look-ups only.

The distribution of a residual, which is an integer, is a mixture of two normals with a common mean. The mean is a
multiple of an eighth of a quantisation step, so there are few different mixtures. Mixtures with many symbols are rare
and not tabulated.
"""

from typing import no_type_check

import numpy as np

from splatwire.codec.gaussians.layout import EIGHTHS, NARROW_WEIGHT, WIDE
from splatwire.entropy.normal_kernels import cumulative
from splatwire.entropy.range_kernels import ONE, ZERO
from splatwire.entropy.tables import MEAN_BITS, NUM_SCALES, TOTAL_BITS
from splatwire.ops.compiled import njit

WEIGHT = np.int64(NARROW_WEIGHT)
NUM_MEANS = np.int64(1 << EIGHTHS)
"""Number of different means, in eighths of a step from -4 on."""
GUESS_BITS = np.int64(8)
NUM_GUESSES = ONE << GUESS_BITS
GUESS_SHIFT = TOTAL_BITS - GUESS_BITS
"""Highest bits of the position of the code, from which the first symbol of the search is looked up."""
MOST_SYMBOLS = np.int64(1 << 10)
"""Maximum number of symbols on either side of a tabulated mixture."""
SCALE, AT, STRIDE, HALF = np.arange(4)
"""Columns of the windows of contexts: scale of the narrow normal, first entry and number of entries of the mixture of
mean -4/8, and number of symbols on either side. The first entry is -1 for mixtures that are not tabulated.
"""


@njit(error_model="numpy")
@no_type_check
def residual_windows(scales, inverses, widths, normal):
    """Tabulates the mixtures of all contexts.

    Args:
        scales: int64 (contexts), scale table index of the narrow normal of each context.
        inverses: Reciprocals of the standard deviations, by scale index.
        widths: Half widths of the windows of directly coded symbols, by scale index.
        normal: Table of the normal cumulative distribution function.

    Returns:
        Windows of the contexts, int64 (contexts, 4), with the columns `SCALE`, `AT`, `STRIDE` and `HALF`; and the
        entries of all mixtures, int32. The entries of a mixture with n symbols are `NUM_GUESSES` indices of symbols, at
        which a decoder starts its search, and the n + 1 bounds of the probability intervals, out of 2**`TOTAL_BITS`.
    """
    windows = np.empty((len(scales), 4), np.int64)
    found, total = np.full(NUM_SCALES, -1, np.int64), np.int64(0)
    for context in range(len(scales)):
        scale = scales[context]
        half = widths[min(scale + WIDE, NUM_SCALES - 1)]
        stride = NUM_GUESSES + 2 * half + 2
        if half <= MOST_SYMBOLS and found[scale] < 0:
            found[scale] = total
            total += NUM_MEANS * stride
        windows[context, SCALE], windows[context, AT] = scale, found[scale]
        windows[context, STRIDE], windows[context, HALF] = stride, half
    entries = np.empty(total, np.int32)
    for scale in range(NUM_SCALES):
        if found[scale] >= 0:
            _tabulate(scale, found[scale], entries, inverses, widths, normal)
    return windows, entries


@njit(borrows=True, error_model="numpy")
@no_type_check
def _tabulate(scale, at, entries, inverses, widths, normal):
    wide = min(scale + WIDE, NUM_SCALES - 1)
    half, narrow_inverse, wide_inverse = widths[wide], inverses[scale], inverses[wide]
    for number in range(NUM_MEANS):
        mean = (number - (NUM_MEANS >> 1)) << (MEAN_BITS - EIGHTHS)
        bounds = at + NUM_GUESSES
        for symbol in range(-half, half + 2):
            entries[bounds + half + symbol] = cumulative(
                symbol, -half, half, mean, narrow_inverse, mean, wide_inverse, WEIGHT, normal
            )
        symbol = ZERO
        for guess in range(NUM_GUESSES):
            while symbol < 2 * half and entries[bounds + symbol + 1] <= guess << GUESS_SHIFT:
                symbol += 1
            entries[at + guess] = symbol
        at = bounds + 2 * half + 2
