"""Numba kernels that encode or decode whole packets of Gaussians."""

from typing import no_type_check

import numpy as np

from splatwire.codec._coder_kernels import DECODING, ENCODING, code_below, code_raw, new_coder
from splatwire.codec._step_kernels import step_exponent
from splatwire.codec.gaussians._axis_kernels import code_axis
from splatwire.codec.gaussians._cell_kernels import code_cells
from splatwire.codec.gaussians._gaussian_kernels import (
    code_class,
    code_colour,
    code_logs,
    position_shift,
)
from splatwire.codec.gaussians._harmonic_kernels import code_harmonics
from splatwire.codec.gaussians._neighbour_kernels import find_neighbours, new_neighbours, predict, store_values
from splatwire.codec.gaussians.layout import (
    AXIS,
    CLASS,
    DIRECTION_BITS,
    MAX_CELL_BITS,
    POSITION,
    PRIMARY,
    SLOT_BITS,
    SPIN,
    SPIN_BITS,
    STEP_DIRECTION,
    STEP_SPIN,
    WINDOW,
)
from splatwire.entropy.range_kernels import ONE, ZERO, decoder_start, encoder_finish, encoder_start
from splatwire.entropy.word_kernels import words_of
from splatwire.ops.compiled import njit

CELL_SHIFT_BITS = np.int64(6)
TARGET_FILL_BITS, MIN_FILL_BITS = 5, 3
"""Parameters of the division of a block into packets of limited size. The encoder aims at a fraction `1 - 2 **
-TARGET_FILL_BITS` of the maximum size, and accepts packets above a fraction `1 - 2 ** -MIN_FILL_BITS`. Most packets are
then encoded only once, which keeps the encoding fast.
"""
ASSUMED_GAUSSIAN_BYTES = 20
"""Assumed number of bytes per Gaussian in the first attempt of a block, which serves only to measure the actual size.
"""
CODES_FIELD, CLASSES_FIELD = 2, 4
"""Indices of `codes` and `precision_classes` among the fields of a `BlockSource`."""
BASE_SIZE = np.int64(2)
"""Estimated coded size of a Gaussian of precision class 0. In the same unit, a Gaussian of class c is larger by c."""
SPARE_BYTES = 64
"""Size of an encoder's buffer in addition to the space for its Gaussians, bytes."""


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _cells_of_codes(codes, cells, narrow):
    """Converts Morton codes of grid cells to cell coordinates.

    Args:
        codes: int64 (n), the Morton codes.
        cells: Output: coordinates of the cells, int64 (3, n).
        narrow: Output: the same coordinates as float32, for the neighbour search.
    """
    for a in range(3):
        for i in range(len(codes)):
            code = (codes[i] >> a) & 0x1249249249249249
            code = (code | (code >> 2)) & 0x10C30C30C30C30C3
            code = (code | (code >> 4)) & 0x100F00F00F00F00F
            code = (code | (code >> 8)) & 0x1F0000FF0000FF
            code = (code | (code >> 16)) & 0x1F00000000FFFF
            cells[a, i] = narrow[a, WINDOW + i] = (code | (code >> 32)) & 0x1FFFFF


@njit(borrows=True, error_model="numpy")
@no_type_check
def reverse_bits(code, bits):
    """Returns the slot of a grid cell: the lowest bits of its Morton code in reversed order.

    The function is its own inverse: applied to a slot, it returns the lowest bits of the code. Grid cells with
    consecutive slots are far apart, so that a lost packet leaves no large hole.

    Args:
        code: Morton code of the grid cell, or its slot.
        bits: Number of bits; the lowest becomes the highest bit of the result.
    """
    reversed_bits = np.int64(0)
    for bit in range(bits):
        reversed_bits |= ((code >> bit) & 1) << (bits - 1 - bit)
    return reversed_bits


@njit(borrows=True, error_model="numpy")
@no_type_check
def _code_cell_codes(coder, codes, bits, spread, slots, stack):
    """Encodes or decodes the Morton codes of the grid cells that contain a packet's Gaussians.

    Args:
        coder: Entropy coder.
        codes: The Morton codes, int64 (n): input of an encoder, output of a decoder.
        bits: Number of bits of a code.
        spread: 1 if the packet's Gaussians are spread over the block, 0 if they are adjacent. If 1, the lowest
            bits of each code are coded separately, because these bits are similar in all Gaussians of the packet. A
            decoder ignores the argument and reads this flag from the packet.
        slots: Working array, int64 (n).
        stack: Working array of `code_cells`.
    """
    # If the Gaussians of a packet are spread over a block, the lowest bits of their codes are similar, and are coded
    # separately.
    spread = code_raw(coder, spread, ONE)
    size = min(bits, SLOT_BITS) if spread else 0
    first, last = np.int64(1 << size), np.int64(0)
    if not coder.decoding:
        for i in range(len(codes)):
            slots[i] = reverse_bits(codes[i], size)
            codes[i] >>= size
            first, last = min(first, slots[i]), max(last, slots[i])
    first = code_raw(coder, first, size)
    count = code_raw(coder, last - first, size) + 1
    code_cells(coder, codes, bits - size, stack)
    for i in range(len(codes)):
        slot = code_below(coder, slots[i] - first, count) if spread else 0
        codes[i] = (codes[i] << size) | reverse_bits((first + slot) & ((1 << size) - 1), size)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _code_position(coder, row, cell, position, cell_shift, shift, absolute):
    """Encodes or decodes the position of a Gaussian within its grid cell, as raw bits.

    Args:
        coder: Entropy coder.
        row: Decoded integers of the Gaussian, int64 (columns); the position relative to the corner of
            the block's bounding box is written, in half lattice spacings.
        cell: Grid cell of the Gaussian, int64 (3).
        position: Position relative to the corner of the block's bounding box, in lattice spacings; only used by an
            encoder.
        cell_shift: log2 of the side of a grid cell, in lattice spacings.
        shift: log2 of the quantisation step, in lattice spacings.
        absolute: False in side information of version 2, where a quantisation step is at most as large as a grid
            cell.
    """
    # The position is nearly random within the cell, so that entropy coding would save nothing.
    low = min(cell_shift, shift)
    for a in range(3):
        fine = (cell[a] << (cell_shift - low)) | code_raw(coder, position[a] >> low, cell_shift - low)
        if absolute:
            fine, row[POSITION + a] = fine >> (shift - low), 1 << shift
            row[POSITION + a] |= fine << (shift + 1)
        else:
            row[POSITION + a] = (fine << (low + 1)) | (1 << low)


@njit(borrows=True, error_model="numpy", forceinline=True)
@no_type_check
def _code_spin(coder, row, axes, primary, bits):
    """Encodes or decodes a Gaussian's rotation angle about its primary axis (see `spin_angle`), as raw bits.

    Args:
        coder: Entropy coder.
        row: Decoded integers of the Gaussian, int64 (columns). Contains the primary axis; the angle is written.
        axes: Exact principal axes as columns, float64 (3, 3); only used by an encoder.
        primary: Column of the primary axis in `axes`: 0 for the axis of the largest scale, 2 for the axis of the
            smallest scale.
        bits: Number of bits of the angle.
    """
    value = np.int64(0)
    if not coder.decoding:
        value = np.int64(np.rint(spin_angle(row, axes, primary) / np.pi * (1 << bits))) & ((1 << bits) - 1)
    row[SPIN_BITS], row[SPIN] = bits, code_raw(coder, value, bits)


@njit(borrows=True, error_model="numpy")
@no_type_check
def spin_angle(row, axes, primary):
    """Returns the rotation angle of a Gaussian about its primary axis, radians, -pi to pi.

    Together with the primary axis, the angle determines the Gaussian's rotation.

    Args:
        row: Decoded integers of the Gaussian, int64 (columns). Columns `AXIS` to `AXIS + 2` are the x, y and z
            components of its primary axis, not normalised.
        axes: Principal axes before quantisation, one in each column, float64 (3, 3).
        primary: Column of the primary axis in `axes`: 0 for the axis of the largest scale, 2 for the axis of the
            smallest scale.
    """
    # The angle is that between column `(primary + 1) % 3` and a direction that is perpendicular to the primary axis and
    # close to a coordinate axis.
    # Written element by element, because numba takes seconds longer to compile `np.cross` and array sums.
    x, y, z = np.float64(row[AXIS]), np.float64(row[AXIS + 1]), np.float64(row[AXIS + 2])
    norm = np.sqrt(x * x + y * y + z * z)
    x, y, z = x / norm, y / norm, z / norm
    if abs(x) <= abs(y) and abs(x) <= abs(z):
        tx, ty, tz = -x * x + 1.0, -x * y, -x * z
    elif abs(y) <= abs(z):
        tx, ty, tz = -y * x, -y * y + 1.0, -y * z
    else:
        tx, ty, tz = -z * x, -z * y, -z * z + 1.0
    norm = np.sqrt(tx * tx + ty * ty + tz * tz)
    tx, ty, tz = tx / norm, ty / norm, tz / norm
    after = (primary + 1) % 3
    vx, vy, vz = axes[0, after], axes[1, after], axes[2, after]
    across = vx * (y * tz - z * ty) + vy * (z * tx - x * tz) + vz * (x * ty - y * tx)
    return np.arctan2(across, vx * tx + vy * ty + vz * tz)


@njit(borrows=True, error_model="numpy", forceinline=True)  # one copy for each direction, without branches on it
@no_type_check
def _code_packet(coder, step_parameters, box_bits, block_means, source, order, rows, harmonics, scratch):
    """Encodes or decodes one packet of n Gaussians.

    Args:
        coder: Entropy coder.
        step_parameters: Parameters of the quantisation steps, from `SideInfo.step_parameters`.
        box_bits: Number of bits of a coordinate within the block's bounding box.
        block_means: Means of the block (see `SideInfo.block_means`), int64 (7).
        source: The block's Gaussians, as fields of a `BlockSource`; ignored by a decoder.
        order: Indices of the packet's Gaussians in `source`, int64 (n); ignored by a decoder.
        rows: Output: decoded integers of each Gaussian except harmonics, int64 (n, columns).
        harmonics: Output: decoded transformed harmonics (see `code_harmonics`), int32 (n, harmonics).
        scratch: Working arrays from `new_scratch`.
    """
    base_exponents, lattice_bits, max_position_shift, flatness_table = step_parameters
    absolute = max_position_shift >= 0  # False with side information of version 2, see `SideInfo.packet_dependent`
    cell_shift, spread, codes, positions, classes, logs, axes, colours, source_harmonics = source
    neighbours, cell_codes, stack, predicted_axis, quantised_axis = scratch
    cells, n = neighbours.cells, len(rows)
    cell_shift = code_raw(coder, cell_shift, CELL_SHIFT_BITS)
    cell_shift = min(max(cell_shift, box_bits - MAX_CELL_BITS), box_bits)
    if not coder.decoding:
        for i in range(n):
            cell_codes[i] = codes[order[i]] >> (3 * (cell_shift - max(box_bits - MAX_CELL_BITS, 0)))
    # `cells[0]` serves as working array, before the cells are written to it.
    _code_cell_codes(coder, cell_codes, 3 * (box_bits - cell_shift), spread, cells[0], stack)
    _cells_of_codes(cell_codes, cells, neighbours.narrow)
    for i in range(n):
        j = 0 if coder.decoding else order[i]
        row = rows[i]
        num_neighbours = find_neighbours(neighbours, i, box_bits - cell_shift)
        row[CLASS] = precision_class = code_class(coder, predict(neighbours, num_neighbours, block_means), classes[j])
        s0, elongation, flatness, opacity, residual_magnitude = code_logs(
            coder, row, logs[j], base_exponents, precision_class, neighbours, num_neighbours, flatness_table, absolute
        )  # fmt: skip
        area = 2 * s0 - elongation
        shift = position_shift(
            base_exponents,
            precision_class,
            s0,
            elongation,
            flatness,
            opacity,
            lattice_bits,
            max_position_shift if absolute else box_bits,
        )
        _code_position(coder, row, cells[:, i], positions[j], cell_shift, shift, absolute)
        row[PRIMARY] = primary = 2 if flatness >= elongation else 0
        exponent = step_exponent(base_exponents, STEP_DIRECTION, precision_class, area, elongation, flatness, opacity)
        shift = min(max(DIRECTION_BITS - exponent, 0), DIRECTION_BITS - 2)
        exact_axis = axes[j, :, primary]
        residual_magnitude = code_axis(
            coder, row, primary, exact_axis, shift, neighbours, num_neighbours, residual_magnitude, predicted_axis,
            quantised_axis, absolute,
        )  # fmt: skip
        exponent = step_exponent(base_exponents, STEP_SPIN, precision_class, area, elongation, flatness, opacity)
        _code_spin(coder, row, axes[j], primary, min(max(exponent, 0), DIRECTION_BITS))
        code_colour(
            coder,
            row,
            colours[j],
            base_exponents,
            precision_class,
            neighbours,
            num_neighbours,
            residual_magnitude,
            absolute,
        )
        store_values(neighbours, row, i)
        if harmonics.shape[1]:
            code_harmonics(coder, harmonics[i], source_harmonics[j], base_exponents, precision_class)


@njit(error_model="numpy")
@no_type_check
def new_scratch(n):
    """Allocates the working arrays for a packet of n Gaussians."""
    return (
        new_neighbours(n),
        np.zeros(n, np.int64),
        np.empty((66, 5), np.int64),
        np.empty(3, np.int64),
        np.empty(3, np.int64),
    )


@njit(error_model="numpy")
@no_type_check
def _encode_packet(
    tables, step_parameters, models, statistics, box_bits, block_means, source, begin, buffer, rows, harmonics
):
    coder = new_coder(ENCODING, buffer, np.empty(0, np.int64), models.copy(), statistics, tables)
    encoder_start(coder.state)
    # Sorted along the Morton curve of the positions, also within a cell, as in `SourceScene.packet_order`. Gaussians of
    # equal codes keep their order.
    order = begin + np.argsort(source[CODES_FIELD][begin : begin + len(rows)], kind="mergesort")
    _code_packet(coder, step_parameters, box_bits, block_means, source, order, rows, harmonics, new_scratch(len(rows)))
    return encoder_finish(buffer, coder.state)


@njit(nogil=True, error_model="numpy")
@no_type_check
def encode_fixed(
    tables, step_parameters, models, statistics, box_bits, block_means, source, counts, buffer, rows, harmonics, ends
):
    """Encodes a block of n Gaussians in packets with given numbers of Gaussians.

    Args:
        tables: Tables of the entropy coder, from `SideInfo.kernel_tables`.
        step_parameters: Parameters of the quantisation steps, from `SideInfo.step_parameters`.
        models: Initial state of the adaptive bit models, equal for all packets, int64 (contexts, 2).
        statistics: Counters of coded symbols, from `empty_statistics`; increased in place.
        box_bits: Number of bits of a coordinate within the block's bounding box.
        block_means: Means of the block (see `SideInfo.block_means`), int64 (7).
        source: The block's Gaussians, as fields of a `BlockSource`.
        counts: Number of Gaussians in each packet, int64 (packets).
        buffer: Output: the payloads one after another, uint8.
        rows: Output: decoded integers of each Gaussian except harmonics, int64 (n, columns).
        harmonics: Output: decoded transformed harmonics (see `code_harmonics`), int32 (n, 3 K), for K harmonics
            of three colour components.
        ends: Output: end of each payload in the buffer, int64 (packets).
    """
    begin, at = ZERO, ZERO  # with the literal 0, numba would compile `_encode_packet` for literals first
    for p in range(len(counts)):
        end = begin + counts[p]
        at += _encode_packet(
            tables, step_parameters, models, statistics, box_bits, block_means, source, begin, buffer[at:],
            rows[begin:end], harmonics[begin:end],
        )  # fmt: skip
        ends[p] = at
        begin = end


@njit(nogil=True, error_model="numpy")
@no_type_check
def encode_limited(
    tables,
    step_parameters,
    models,
    statistics,
    box_bits,
    block_means,
    source,
    max_payload_bytes,
    buffer,
    rows,
    harmonics,
    counts,
    ends,
):
    """Encodes a block of n Gaussians in packets of limited size, each nearly full.

    The encoder aims at 31/32 of the size and accepts a packet above 7/8 of it, or, after seven attempts, any that fits.

    Args:
        tables: Tables of the entropy coder, from `SideInfo.kernel_tables`.
        step_parameters: Parameters of the quantisation steps, from `SideInfo.step_parameters`.
        models: Initial state of the adaptive bit models, equal for all packets, int64 (contexts, 2).
        statistics: Counters of coded symbols, from `empty_statistics`; increased in place.
        box_bits: Number of bits of a coordinate within the block's bounding box.
        block_means: Means of the block (see `SideInfo.block_means`), int64 (7).
        source: The block's Gaussians, as fields of a `BlockSource`.
        max_payload_bytes: Maximum size of a packet's payload, bytes.
        buffer: Output: the payloads one after another, uint8.
        rows: Output: decoded integers of each Gaussian except harmonics, int64 (n, columns).
        harmonics: Output: decoded transformed harmonics (see `code_harmonics`), int32 (n, harmonics).
        counts: Output: number of Gaussians in each packet, int64 (n).
        ends: Output: end of each payload in the buffer, int64 (n).

    Returns:
        Number of packets.
    """
    total, begin, at, num_packets = len(rows), ZERO, ZERO, 0
    target_bytes = max_payload_bytes - (max_payload_bytes >> TARGET_FILL_BITS)
    # Sum of the estimated sizes (`_relative_size`) of all Gaussians in finished packets.
    precision_classes, coded_size = source[CLASSES_FIELD], np.int64(0)
    while begin < total:
        num_left = total - begin
        low, high, num_tries, last_tried, length = 0, num_left + 1, 0, 0, 0
        n = (
            _count_within(precision_classes[begin:], coded_size * target_bytes // at)
            if at
            else min(max(max_payload_bytes // ASSUMED_GAUSSIAN_BYTES, 1), num_left)
        )
        # Searches for a number of Gaussians that nearly fill the packet: `low` fit, `high` do not.
        while high - low > 1:
            length = _encode_packet(
                tables, step_parameters, models, statistics, box_bits, block_means, source, begin, buffer[at:],
                rows[begin : begin + n], harmonics[begin : begin + n],
            )  # fmt: skip
            num_tries, last_tried = num_tries + 1, n
            if length <= max_payload_bytes or n == 1:
                low = n
                if n == num_left or length >= max_payload_bytes - (max_payload_bytes >> MIN_FILL_BITS) or num_tries > 6:
                    break
            else:
                high = n
            max_size = _relative_size(precision_classes[begin : begin + n]) * target_bytes // max(length, 1)
            n = min(max(_count_within(precision_classes[begin:], max_size), low + 1), high - 1)
        if last_tried != low:
            length = _encode_packet(
                tables, step_parameters, models, statistics, box_bits, block_means, source, begin, buffer[at:],
                rows[begin : begin + low], harmonics[begin : begin + low],
            )  # fmt: skip
        at += length
        counts[num_packets], ends[num_packets] = low, at
        coded_size += _relative_size(precision_classes[begin : begin + low])
        begin += low
        num_packets += 1
    return num_packets


@njit(borrows=True, error_model="numpy")
@no_type_check
def _relative_size(precision_classes):
    """Estimates the total coded size of n Gaussians, in an arbitrary unit.

    Only sizes of Gaussians of the same block can be compared.

    Args:
        precision_classes: Precision class of each Gaussian, int64 (n).
    """
    # Within blocks, sizes of packets deviate from these sums by 1.8 % (standard deviation, two scenes of degree 1
    # and 3), and by 4 % from the number of Gaussians.
    size = np.int64(0)
    for i in range(len(precision_classes)):
        size += precision_classes[i] + BASE_SIZE
    return size


@njit(borrows=True, error_model="numpy")
@no_type_check
def _count_within(precision_classes, max_size):
    """Returns the number of leading Gaussians whose estimated total size is within a limit; at least 1.

    Args:
        precision_classes: Precision class of each Gaussian, int64 (n).
        max_size: Maximum total size, in the unit of `_relative_size`.
    """
    count, total = 0, np.int64(0)
    while count < len(precision_classes):
        total += precision_classes[count] + BASE_SIZE
        if total > max_size:
            break
        count += 1
    return max(count, 1)


@njit(nogil=True, error_model="numpy")
@no_type_check
def decode_packets(
    tables, step_parameters, models, data, byte_starts, gaussian_starts, box_bits, block_means, rows, harmonics
):
    """Decodes P packets with n Gaussians in total to integers.

    Args:
        tables: Tables of the entropy coder, from `SideInfo.kernel_tables`.
        step_parameters: Parameters of the quantisation steps, from `SideInfo.step_parameters`.
        models: Initial state of the adaptive bit models, equal for all packets, int64 (contexts, 2).
        data: Payloads of P packets, one after another, uint8.
        byte_starts: int64 (P + 1); packet p has the bytes `data[byte_starts[p]:byte_starts[p + 1]]`.
        gaussian_starts: int64 (P + 1); packet p has the Gaussians `gaussian_starts[p]` to `gaussian_starts[p + 1]`
            (exclusive).
        box_bits: Number of bits of a coordinate within the bounding box of each packet's block, int64 (P).
        block_means: Means of each packet's block (see `SideInfo.block_means`), int64 (P, 7).
        rows: Output: decoded integers of each Gaussian except harmonics, int64 (n, columns).
        harmonics: Output: decoded transformed harmonics (see `code_harmonics`), int32 (n, harmonics).
    """
    statistics = np.zeros((1, 2), np.int64), np.zeros((1, 1, 1, 2), np.int64)
    one, three, four = np.zeros(1, np.int64), np.zeros((1, 3), np.int64), np.zeros((1, 4), np.int64)
    source = (ZERO, ZERO, one, three, one, four, np.zeros((1, 3, 3)), three, np.zeros((1, 3), np.int32))
    for p in range(len(gaussian_starts) - 1):
        begin, end = gaussian_starts[p], gaussian_starts[p + 1]
        payload = data[byte_starts[p] : byte_starts[p + 1]]
        coder = new_coder(DECODING, payload, words_of(payload), models.copy(), statistics, tables)
        decoder_start(payload, ZERO, len(payload), coder.state)
        _code_packet(
            coder,
            step_parameters,
            box_bits[p],
            block_means[p],
            source,
            one,
            rows[begin:end],
            harmonics[begin:end],
            new_scratch(end - begin),
        )
