"""Numba kernels that tabulate the probability distributions of prediction residuals.

Each distribution is a mixture of two normal distributions with the same mean. Means are multiples of an eighth of a
quantisation step.
"""
# A bound is the start of a residual's probability interval. For a mixture with many possible residuals, the table
# contains only every `2**k`-th bound.

from typing import no_type_check

import numpy as np

from splatwire.codec.gaussians.layout import MEAN_FRACTION_BITS, NARROW_WEIGHT, WIDE_SCALE_OFFSET
from splatwire.entropy.normal_kernels import cumulative
from splatwire.entropy.range_kernels import ONE, ZERO
from splatwire.entropy.tables import MEAN_BITS, NUM_SCALES, TOTAL_BITS
from splatwire.ops.compiled import njit

WEIGHT = np.int64(NARROW_WEIGHT)
NUM_MEANS = np.int64(1 << MEAN_FRACTION_BITS)
"""Number of different means, in eighths of a step from -4 on."""
MAX_SYMBOLS = np.int64(1 << 10)
"""Largest `max_magnitude` of a mixture for which every bound is tabulated."""
MAX_INTERVALS = np.int64(1 << 9)
"""Maximum number of tabulated intervals of a mixture with more symbols."""
MAX_GUESS_BITS = np.int64(8)
"""Maximum number of bits of an index into the table of guesses: the highest bits of the code's position."""
MAX_MAGNITUDE, SHIFT, FIRST_BOUND, STRIDE, GUESS_AT, GUESS_BITS = np.arange(6)
"""Columns of `distributions`: largest tabulated magnitude; log2 of the number of symbols between two tabulated bounds;
first bound of the mixture of mean -4/8 and number of bounds of each mixture; first guess of the mixture of mean -4/8
and log2 of the number of guesses of each mixture.
"""


@njit(error_model="numpy")
@no_type_check
def residual_distributions(scale_indices, inverse_scales, widths, normal_cdf):
    """Tabulates the probability distributions of prediction residuals for the entropy coder.

    Each distribution is a mixture of two normals. For every standard deviation in `scale_indices`, there are
    `NUM_MEANS` distributions with different means.

    Args:
        scale_indices: Index of each context's standard deviation in the coder's table, int64 (contexts).
        inverse_scales: Reciprocal of each standard deviation in the coder's table.
        widths: For each standard deviation in the coder's table, the largest magnitude of residuals that have a
            probability interval of their own.
        normal_cdf: Table of the normal cumulative distribution function.

    Returns:
        Four arrays, which are fields of `Coder`:

        `scale_indices`: the argument as uint16 (contexts).

        `distributions`: one row for each standard deviation: its range of residuals, and where its distributions start
        in the other arrays; int64 (standard deviations, 6). Constants of this module, such as `MAX_MAGNITUDE` and
        `GUESS_BITS`, name the columns.

        `bounds`: starts of the probability intervals, in units of 2**-`TOTAL_BITS`, int32.

        `guesses`: interval at which a decoder starts its search, given the highest bits of the code, uint16.
    """
    # The tables are accessed at random. They are small enough for the processor's caches.
    distributions = np.zeros((NUM_SCALES, 6), np.int64)
    num_bounds = num_guesses = np.int64(0)
    for scale in scale_indices:
        if distributions[scale, STRIDE]:
            continue
        max_magnitude = widths[min(scale + WIDE_SCALE_OFFSET, NUM_SCALES - 1)]
        shift = guess_bits = ZERO
        while max_magnitude > MAX_SYMBOLS and (2 * max_magnitude >> shift) >= MAX_INTERVALS:
            shift += 1
        while max_magnitude >> guess_bits and guess_bits < MAX_GUESS_BITS:
            guess_bits += 1
        stride = (2 * max_magnitude >> shift) + 2
        table_row = distributions[scale]
        table_row[MAX_MAGNITUDE], table_row[SHIFT] = max_magnitude, shift
        table_row[FIRST_BOUND], table_row[STRIDE] = num_bounds, stride
        table_row[GUESS_AT], table_row[GUESS_BITS] = num_guesses, guess_bits
        num_bounds += NUM_MEANS * stride
        num_guesses += NUM_MEANS << guess_bits
    bounds, guesses = np.empty(num_bounds, np.int32), np.empty(num_guesses, np.uint16)
    for scale in range(NUM_SCALES):
        if distributions[scale, STRIDE]:
            _tabulate(scale, distributions[scale], bounds, guesses, inverse_scales, widths, normal_cdf)
    return scale_indices.astype(np.uint16), distributions, bounds, guesses


@njit(borrows=True, error_model="numpy")
@no_type_check
def _tabulate(scale, table_row, bounds, guesses, inverse_scales, widths, normal_cdf):
    wide = min(scale + WIDE_SCALE_OFFSET, NUM_SCALES - 1)
    max_magnitude = table_row[MAX_MAGNITUDE]
    narrow_inverse, wide_inverse = inverse_scales[scale], inverse_scales[wide]
    bounds_at, last = table_row[FIRST_BOUND], table_row[STRIDE] - 2
    guess_at, guess_bits = table_row[GUESS_AT], table_row[GUESS_BITS]
    for mean_index in range(NUM_MEANS):
        mean = (mean_index - (NUM_MEANS >> 1)) << (MEAN_BITS - MEAN_FRACTION_BITS)
        for interval in range(last + 2):
            bounds[bounds_at + interval] = cumulative(
                (interval << table_row[SHIFT]) - max_magnitude,
                -max_magnitude,
                max_magnitude,
                mean,
                narrow_inverse,
                mean,
                wide_inverse,
                WEIGHT,
                normal_cdf,
            )
        interval = ZERO
        for guess in range(ONE << guess_bits):
            while interval < last and bounds[bounds_at + interval + 1] <= guess << (TOTAL_BITS - guess_bits):
                interval += 1
            guesses[guess_at + guess] = interval
        bounds_at += last + 2
        guess_at += ONE << guess_bits
