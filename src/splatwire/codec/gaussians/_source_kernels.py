"""Numba kernels that convert Gaussians to the fixed-point input of the encoder, and sort them in each block.

The sorted order is the one in which packets are filled.

The functions of numpy that these kernels replace are in `tests/reference/gaussian_sources.py`.
"""
# Kernels read the scene's arrays by index, because copies of the Gaussians of a block would cost another pass.

from typing import no_type_check

import numpy as np

from splatwire.codec.gaussians.layout import BITS, MAX_COLOUR, MAX_LOG, MAX_LOG_OPACITY, MIN_LOG_OPACITY, SLOT_BITS
from splatwire.entropy.range_kernels import ZERO
from splatwire.ops.compiled import njit
from splatwire.ops.prefetch import LINE_BYTES, prefetch

PREFETCH_DISTANCE = 8
"""Number of Gaussians ahead for which kernels prefetch rows of the scene's arrays."""
OUTLIER_DIVISOR = 50
"""When the extent of a block's positions is estimated, one in this number of positions (2 %) at either end of each axis
counts as an outlier. The extent determines the cell size of the block's coarse grid, which all its packets use.
"""
MAX_EXTENT_RATIO = 2
"""Maximum ratio of the estimated extent to the extent without outliers."""
BUCKET_BITS = 9
"""log2 of the number of buckets into which values are divided, to find one by its rank."""
DIGIT_BITS = 11
"""Number of bits of a digit of the radix sort."""
MAX_TRANSFORMED = 1 << 30
"""Largest magnitude of a transformed harmonic before quantisation: the inverse of a damaged transform may be large."""


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _fixed(value, low, high):
    """Rounds a number to fixed point with `BITS` fractional bits, and clips it to the range `low` to `high`."""
    return np.int64(min(max(np.rint(value * (1 << BITS)), low), high))


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _largest_first(scales):
    """Returns the indices of three scales in decreasing order; equal scales keep their order."""
    a, b, c = 0, 1, 2
    if scales[b] > scales[a]:
        a, b = b, a
    if scales[c] > scales[b]:
        b, c = c, b
        if scales[b] > scales[a]:
            a, b = b, a
    return a, b, c


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _write_logs(opacity, scales, size_log, row):
    """Writes base-2 logarithms of the opacity and of the scales, largest first, in fixed point.

    Args:
        opacity: Opacity of the Gaussian.
        scales: Its standard deviations, float32 (3).
        size_log: log2 of the scene size in world units; scales are relative to this size.
        row: Output, int64 (4).
    """
    low, high = min(scales[0], scales[1]), max(scales[0], scales[1])
    middle = max(low, min(high, scales[2]))
    row[0] = _fixed(np.log2(np.float64(opacity)), MIN_LOG_OPACITY, MAX_LOG_OPACITY)
    row[1] = _fixed(np.log2(np.float64(max(high, scales[2]))) - size_log, -MAX_LOG, MAX_LOG)
    row[2] = _fixed(np.log2(np.float64(middle)) - size_log, -MAX_LOG, MAX_LOG)
    row[3] = _fixed(np.log2(np.float64(min(low, scales[2]))) - size_log, -MAX_LOG, MAX_LOG)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def write_logs(opacities, scales, size_log, logs):
    """Writes base-2 logarithms of the opacities and scales of n Gaussians in fixed point.

    Args:
        opacities: float32 (n).
        scales: Standard deviations, float32 (n, 3).
        size_log: log2 of the scene size in world units; scales are relative to this size.
        logs: Output: opacity and scales, largest first, int64 (n, 4).
    """
    for i in range(len(logs)):
        _write_logs(opacities[i], scales[i], size_log, logs[i])


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def write_colours(base, matrix, grey, colours):
    """Converts base colours of n Gaussians to Y Co Cg in fixed point.

    Args:
        base: Spherical harmonics of degree 0, float32 (n, 3).
        matrix: Transform from RGB to Y Co Cg, times the value of the harmonic of degree 0, float64 (3, 3).
        grey: Y Co Cg of a Gaussian whose harmonics are 0, float64 (3).
        colours: Output, int64 (n, 3).
    """
    for i in range(len(base)):
        _write_colour(base[i], matrix, grey, colours[i])


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _write_colour(base, matrix, grey, colour):
    """Converts the base colour of a Gaussian to Y Co Cg in fixed point; see `write_colours`."""
    r, g, b = np.float64(base[0]), np.float64(base[1]), np.float64(base[2])
    for c in range(3):
        value = grey[c] + (r * matrix[c, 0] + g * matrix[c, 1] + b * matrix[c, 2])
        colour[c] = _fixed(value, -MAX_COLOUR, MAX_COLOUR)


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def write_axes(scales, quats, axes):
    """Writes the principal axes of n Gaussians as columns, in the order of decreasing scale.

    Args:
        scales: Standard deviations, float32 (n, 3).
        quats: Quaternions (w, x, y, z) of any length, float32 (n, 4).
        axes: Output, float64 (n, 3, 3).
    """
    for i in range(len(axes)):
        _write_axes(scales[i], quats[i], axes[i])


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _write_axes(scales, quat, axes):
    """Writes the principal axes of a Gaussian as columns, in the order of decreasing scale, float64 (3, 3)."""
    w, x, y, z = np.float64(quat[0]), np.float64(quat[1]), np.float64(quat[2]), np.float64(quat[3])
    norm = np.sqrt(w * w + x * x + y * y + z * z)
    w, x, y, z = w / norm, x / norm, y / norm, z / norm
    one = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
    two = (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x))
    three = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
    first, second, _ = _largest_first(scales)
    for a in range(3):
        columns = one[a], two[a], three[a]
        axes[a, 0], axes[a, 1] = columns[first], columns[second]
        axes[a, 2] = columns[3 - first - second]


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def write_codes(positions, shift, codes):
    """Computes Morton codes of positions after dropping the lowest bits of each coordinate.

    Args:
        positions: Lattice positions, int64 (n, 3), not negative.
        shift: Number of dropped bits of a coordinate. At most `MAX_CELL_BITS` bits remain.
        codes: Output, int64 (n).

    Returns:
        Bitwise OR of all coordinates after the low bits were dropped. It is negative if any coordinate is negative.
    """
    used_bits = np.int64(0)
    for i in range(len(codes)):
        x, y, z = positions[i, 0] >> shift, positions[i, 1] >> shift, positions[i, 2] >> shift
        used_bits |= x | y | z
        codes[i] = _interleave(x) | (_interleave(y) << 1) | (_interleave(z) << 2)
    return used_bits


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _interleave(bits):
    """Moves bit i of a number to bit `3 * i`. Only the 21 lowest bits are used."""
    bits = (bits | (bits << 32)) & 0x1F00000000FFFF
    bits = (bits | (bits << 16)) & 0x1F0000FF0000FF
    bits = (bits | (bits << 8)) & 0x100F00F00F00F00F
    bits = (bits | (bits << 4)) & 0x10C30C30C30C30C3
    return (bits | (bits << 2)) & 0x1249249249249249


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def round_positions(means, shifts, factor, half_unit):
    """Moves each position to the middle of its quantisation step. The step may differ between positions.

    Args:
        means: Positions, float32 (n, 3), changed in place.
        shifts: log2 of the quantisation step of each position, in lattice spacings, int64 (n).
        factor: Reciprocal of the spacing of the lattice, a power of two.
        half_unit: Half the spacing of the lattice.

    Returns:
        Largest magnitude of a lattice coordinate.
    """
    max_magnitude = 0.0
    for i in range(len(means)):
        for a in range(3):
            # Twice: the middle of a step near float32 precision is rounded, possibly into a neighbouring step.
            for _ in range(2):
                value = np.floor(np.float64(means[i, a]) * factor)
                max_magnitude = max(max_magnitude, abs(value))
                means[i, a] = np.float64((2 * (np.int64(value) >> shifts[i]) + 1) << shifts[i]) * half_unit
    return max_magnitude


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def write_block_positions(indices, centres, factor, corner, shift, positions, codes):
    """Computes lattice positions within the bounding box of a block, and their Morton codes; see `write_codes`.

    Args:
        indices: Indices of the block's Gaussians in `centres`, uint32 (n).
        centres: Positions of all Gaussians, float32 (N, 3).
        factor: Reciprocal of the spacing of the lattice, a power of two.
        corner: Lower corner of the bounding box, in lattice spacings, int64 (3).
        shift: Number of low bits of each coordinate that the Morton codes leave out.
        positions: Output: lattice positions relative to the corner, int64 (n, 3).
        codes: Output, int64 (n).

    Returns:
        Largest magnitude of a coordinate before the corner was subtracted; and the bitwise OR of all coordinates after
        the `shift` low bits were dropped. The second number shows which bits are in use.
    """
    max_magnitude, used_bits, last = 0.0, np.int64(0), len(indices) - 1
    for i in range(len(indices)):
        prefetch(centres, np.int64(indices[min(i + PREFETCH_DISTANCE, last)]), ZERO)
        index = np.int64(indices[i])
        for a in range(3):
            value = np.floor(np.float64(centres[index, a]) * factor)
            max_magnitude = max(max_magnitude, abs(value))
            positions[i, a] = np.int64(value) - corner[a]
        x, y, z = positions[i, 0] >> shift, positions[i, 1] >> shift, positions[i, 2] >> shift
        used_bits |= x | y | z
        codes[i] = _interleave(x) | (_interleave(y) << 1) | (_interleave(z) << 2)
    return max_magnitude, used_bits


@njit(nogil=True, error_model="numpy")
@no_type_check
def sort_cells(codes, shift, contiguous):
    """Sorts the Gaussians of a block in the order in which packets are filled.

    Args:
        codes: Morton codes of the positions, int64 (n), not negative.
        shift: Number of low bits of the codes to ignore. The other bits are the Morton code of the grid cell.
        contiguous: True to sort by the cell's code, so that a packet contains adjacent Gaussians. False to spread each
            packet over the block: the first sort key is then the lowest `SLOT_BITS` bits of the cell's code in reversed
            order, and the second sort key is the cell's code.

    Returns:
        Entry i is the index in `codes` of the i-th Gaussian in sorted order, int64 (n). Gaussians with equal sort keys
        keep their order.
    """
    # Radix sort: by the digits of the code from the lowest one on, then by the reversed bits.
    used_bits, first_bit = np.int64(0), shift
    for code in codes:
        used_bits |= code >> shift
    order, next_order = np.arange(len(codes)), np.empty(len(codes), np.int64)
    starts = np.empty((1 << DIGIT_BITS) + 1, np.int64)
    while used_bits:
        starts[:] = 0
        for i in range(len(codes)):
            starts[((codes[i] >> shift) & ((1 << DIGIT_BITS) - 1)) + 1] += 1
        for digit in range(1 << DIGIT_BITS):
            starts[digit + 1] += starts[digit]
        for index in order:
            digit = (codes[index] >> shift) & ((1 << DIGIT_BITS) - 1)
            next_order[starts[digit]] = index
            starts[digit] += 1
        order, next_order = next_order, order
        shift, used_bits = shift + DIGIT_BITS, used_bits >> DIGIT_BITS
    if contiguous:
        return order
    slots = np.zeros(len(codes), np.uint8)
    for bit in range(SLOT_BITS):
        for i in range(len(codes)):
            slots[i] |= ((codes[i] >> (first_bit + bit)) & 1) << (SLOT_BITS - 1 - bit)
    starts[: (1 << SLOT_BITS) + 1] = 0
    for slot in slots:
        starts[np.int64(slot) + 1] += 1
    for slot in range(1 << SLOT_BITS):
        starts[slot + 1] += starts[slot]
    for index in order:
        slot = np.int64(slots[index])
        next_order[starts[slot]] = index
        starts[slot] += 1
    return next_order


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def summarise_block(indices, centres, scales, opacities, sh, factor, size_log, matrix, grey, scratch, bounds, means):
    """Computes the bounding box of a block of Gaussians, and the means of their coded attributes.

    Args:
        indices: Indices of the block's Gaussians in the next four arrays, uint32 (n).
        centres: Positions of all Gaussians, float32 (N, 3).
        scales: Standard deviations, float32 (N, 3).
        opacities: float32 (N).
        sh: Spherical harmonics, float32 (N, K + 1, 3).
        factor: Reciprocal of the lattice spacing of positions, a power of two.
        size_log: log2 of the scene size in world units.
        matrix: Transform of base colours, see `write_colours`.
        grey: Y Co Cg of a Gaussian whose harmonics are 0, float64 (3).
        scratch: Working array, int64 (2, 4).
        bounds: Output: smallest and largest coordinates in lattice spacings, int64 (2, 3).
        means: Output: seven means in fixed point with `BITS` fractional bits, float64 (7). Entries 0 to 2 are the means
            of three logarithms: of the opacity, of the largest scale, and of the ratio of the largest to the second
            scale. Entry 3 is the mean of the companded ratio of the second to the third scale. Entries 4 to 6 are the
            means of Y, Co and Cg.

    Returns:
        Largest magnitude of a coordinate, in lattice spacings.
    """
    max_magnitude, logs, colour, last = 0.0, scratch[0], scratch[1], len(indices) - 1
    for a in range(7):
        means[a] = 0.0
    for i in range(len(indices)):
        index = np.int64(indices[min(i + PREFETCH_DISTANCE, last)])
        prefetch(centres, index, ZERO)
        prefetch(scales, index, ZERO)
        prefetch(opacities, index, ZERO)
        prefetch(sh, index, ZERO)
        index = np.int64(indices[i])
        for a in range(3):
            value = np.floor(np.float64(centres[index, a]) * factor)
            max_magnitude = max(max_magnitude, abs(value))
            coord = np.int64(value)
            bounds[0, a] = min(bounds[0, a], coord) if i else coord
            bounds[1, a] = max(bounds[1, a], coord) if i else coord
        _write_logs(opacities[index], scales[index], size_log, logs)
        _write_colour(sh[index, 0], matrix, grey, colour)
        means[0] += logs[0]
        means[1] += logs[1]
        means[2] += logs[1] - logs[2]
        means[3] += (1 - np.exp2((logs[3] - logs[2]) / (1 << BITS))) / np.log(2.0) * (1 << BITS)
        for c in range(3):
            means[4 + c] += colour[c]
    for a in range(7):
        means[a] /= len(indices)
    return max_magnitude


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _luma_chroma(harmonic, factors):
    """Computes luma or one of the chroma components of a spherical harmonic, clipped to the range of the format.

    Args:
        harmonic: Red, green and blue of the harmonic, (3).
        factors: Row of the transform from RGB to Y Co Cg, in fixed point, (3).
    """
    value = np.float64(harmonic[0]) * factors[0] + np.float64(harmonic[1]) * factors[1]
    value += np.float64(harmonic[2]) * factors[2]
    return min(max(value, -np.float64(MAX_COLOUR)), np.float64(MAX_COLOUR))


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def write_harmonics(sh, luma_chroma, harmonics):
    """Converts spherical harmonics above degree 0 to Y Co Cg, scaled for fixed point but not rounded to integers.

    Args:
        sh: Spherical harmonics, float32 (n, K + 1, 3).
        luma_chroma: Transform from RGB to Y Co Cg in fixed point, float64 (3, 3).
        harmonics: Output, float64 (n, K, 3).
    """
    for i in range(len(harmonics)):
        for k in range(harmonics.shape[1]):
            for c in range(3):
                harmonics[i, k, c] = _luma_chroma(sh[i, k + 1], luma_chroma[c])


@njit(borrows=True, nogil=True, error_model="numpy")
@no_type_check
def gather_sources(
    indices, quats, scales, opacities, sh, size_log, matrix, grey, luma_chroma, inverse, zero_thresholds, scratch,
    precision_classes, logs, axes, colours, harmonics,
):  # fmt: skip
    """Converts n of N Gaussians to the fixed-point input of the encoding kernels (fields of `BlockSource`).

    Args:
        indices: Indices of the n Gaussians in the next four arrays, uint32 (n).
        quats: Quaternions (w, x, y, z) of any length, float32 (N, 4).
        scales: Standard deviations, float32 (N, 3).
        opacities: float32 (N).
        sh: Spherical harmonics, float32 (N, K + 1, 3).
        size_log: log2 of the scene size in world units.
        matrix: Transform of base colours, see `write_colours`.
        grey: Y Co Cg of a Gaussian whose harmonics are 0, float64 (3).
        luma_chroma: Transform of harmonics from RGB to Y Co Cg in fixed point, float64 (3, 3).
        inverse: Matrix of the encoder's transform, float64 (K, columns). Transformed harmonic k is the product of
            column k with the K harmonics of a colour component. Columns from K on are 0.
        zero_thresholds: Threshold for each precision class, float64 (classes). It is compared with the Euclidean length
            of the K harmonics of a colour component. If all three lengths of a Gaussian are below the threshold,
            quantisation would make all its harmonics 0, so 0 is written without applying the transform.
        scratch: Working array, float64 (6, columns).
        precision_classes: Precision class (set of quantisation steps) of each of the n Gaussians, int64 (n).
        logs: Output, int64 (n, 4), see `write_logs`.
        axes: Output, float64 (n, 3, 3), see `write_axes`.
        colours: Output, int64 (n, 3), see `write_colours`.
        harmonics: Output, int32 (n, 3 K): Y, Co and Cg of the first transformed harmonic, then of the second, and so
            on.
    """
    num_harmonics, width, values, sums = len(inverse), inverse.shape[1], scratch[:3], scratch[3:]
    last, num_cache_lines = len(indices) - 1, (12 * num_harmonics + 11) // LINE_BYTES + 1
    for i in range(len(indices)):
        index = np.int64(indices[min(i + PREFETCH_DISTANCE, last)])
        prefetch(quats, index, ZERO)
        prefetch(scales, index, ZERO)
        prefetch(opacities, index, ZERO)
        for line in range(num_cache_lines):
            prefetch(sh, index, line)
        index = np.int64(indices[i])
        _write_logs(opacities[index], scales[index], size_log, logs[i])
        _write_axes(scales[index], quats[index], axes[i])
        _write_colour(sh[index, 0], matrix, grey, colours[i])
        squared_length = 0.0
        for c in range(3):
            total = 0.0
            for k in range(num_harmonics):
                values[c, k] = _luma_chroma(sh[index, k + 1], luma_chroma[c])
                total += values[c, k] * values[c, k]
            squared_length = max(squared_length, total)
        threshold = zero_thresholds[precision_classes[i]]
        if squared_length < threshold * threshold:
            for j in range(3 * num_harmonics):
                harmonics[i, j] = 0
            continue
        for c in range(3):
            for b in range(width):
                sums[c, b] = 0.0
        for k in range(num_harmonics):
            y, co, cg = values[0, k], values[1, k], values[2, k]
            for b in range(width):
                sums[0, b] += y * inverse[k, b]
                sums[1, b] += co * inverse[k, b]
                sums[2, b] += cg * inverse[k, b]
        for b in range(num_harmonics):
            for c in range(3):
                harmonics[i, 3 * b + c] = np.int32(min(max(np.rint(sums[c, b]), -MAX_TRANSFORMED), MAX_TRANSFORMED))


@njit(nogil=True, error_model="numpy")
@no_type_check
def _value_at_rank(values, counts, min_value, shift, rank):
    """Returns the value that is at index `rank` in sorted order. Only one bucket of values is actually sorted.

    Args:
        values: Integers, not sorted, int64 (n).
        counts: Number of values in each bucket, int64; the bucket of a value is `(value - min_value) >> shift`.
        min_value: Smallest value.
        shift: log2 of the size of a bucket.
        rank: Position in the sorted values, from 0.
    """
    bucket = 0
    while rank >= counts[bucket]:
        rank -= counts[bucket]
        bucket += 1
    bucket_values, count = np.empty(counts[bucket], np.int64), 0
    for value in values:
        if (value - min_value) >> shift == bucket:
            bucket_values[count] = value
            count += 1
    bucket_values.sort()
    return bucket_values[rank]


@njit(nogil=True, error_model="numpy")
@no_type_check
def extents(positions, starts):
    """Estimates the extent of groups of positions. A few outliers have little influence on the result.

    Args:
        positions: Integer positions, group after group, int64 (n, 3).
        starts: Start of each group in `positions`, and the end of the last group, int64 (groups + 1). No group is
            empty.

    Returns:
        Extent of each group along the axis on which it is largest, int64 (groups).
    """
    largest, counts = np.zeros(len(starts) - 1, np.int64), np.empty(1 << BUCKET_BITS, np.int64)
    for group in range(len(starts) - 1):
        begin, end = starts[group], starts[group + 1]
        num_outliers = (end - begin - 1) // OUTLIER_DIVISOR
        for a in range(3):
            values = positions[begin:end, a].copy()
            low, high, shift = values.min(), values.max(), 0
            while (high - low) >> shift >> BUCKET_BITS:
                shift += 1
            counts[:] = 0
            for value in values:
                counts[(value - low) >> shift] += 1
            extent = _value_at_rank(values, counts, low, shift, end - begin - 1 - num_outliers)
            extent -= _value_at_rank(values, counts, low, shift, num_outliers)
            largest[group] = max(largest[group], min(high - low, MAX_EXTENT_RATIO * extent))
    return largest
