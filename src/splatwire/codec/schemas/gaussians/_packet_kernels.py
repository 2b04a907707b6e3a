"""Numba kernels that code whole packets: cells of all Gaussians first, then one Gaussian after another."""

from typing import no_type_check

import numpy as np

from splatwire.codec.schemas._coder_kernels import DECODING, ENCODING, code_below, code_raw, new_coder
from splatwire.codec.schemas._step_kernels import exponent
from splatwire.codec.schemas.gaussians._axis_kernels import code_axis
from splatwire.codec.schemas.gaussians._cell_kernels import code_cells
from splatwire.codec.schemas.gaussians._gaussian_kernels import (
    code_class,
    code_colour,
    code_logs,
    find_neighbours,
    place_shift,
)
from splatwire.codec.schemas.gaussians._harmonic_kernels import code_harmonics
from splatwire.codec.schemas.gaussians.layout import (
    AXIS,
    CLASS,
    DIRECTION_BITS,
    LATTICE,
    MAX_CELL_BITS,
    NUM_NEIGHBOURS,
    PRIMARY,
    S_DIRECTION,
    S_SPIN,
    SLOT_BITS,
    SPIN,
    SPIN_BITS,
)
from splatwire.entropy.range_kernels import ONE, ZERO, decoder_start, encoder_finish, encoder_start
from splatwire.ops.compiled import njit

CELLS_AT_BITS = np.int64(6)
AIM, ENOUGH = 5, 3
"""Packets are aimed at a share `1 - 2 ** -AIM` of their size and taken from `1 - 2 ** -ENOUGH` on:
then most are encoded once, which is what takes the time."""
FIRST = 20
"""Bytes of a Gaussian in the first try of a block, which only tells how many they are."""
SLACK = 64
"""Bytes of a packet's buffer besides those of its Gaussians."""


@njit(borrows=True, error_model="numpy")
@no_type_check
def _spread_cells(codes, cells, bits):
    for i in range(len(codes)):
        for a in range(3):
            value = np.int64(0)
            for bit in range(bits):
                value |= ((codes[i] >> (3 * bit + a)) & 1) << bit
            cells[i, a] = value


@njit(borrows=True, error_model="numpy")
@no_type_check
def slot_of(code, bits):
    """The lowest bits of a code in reverse order: cells whose slots are close are far apart, and evenly spread."""
    slot = np.int64(0)
    for bit in range(bits):
        slot |= ((code >> bit) & 1) << (bits - 1 - bit)
    return slot


@njit(borrows=True, error_model="numpy")
@no_type_check
def _code_codes(coder, codes, bits, spread, slots, stack):
    """Codes Morton codes of `bits` bits, of a spread packet all but their slots as a tree, then its run of slots."""
    spread = code_raw(coder, spread, ONE)
    size = min(bits, SLOT_BITS) if spread else 0
    first, last = np.int64(1 << size), np.int64(0)
    if not coder.decoding:
        for i in range(len(codes)):
            slots[i] = slot_of(codes[i], size)
            codes[i] >>= size
            first, last = min(first, slots[i]), max(last, slots[i])
    first = code_raw(coder, first, size)
    count = code_raw(coder, last - first, size) + 1
    code_cells(coder, codes, bits - size, stack)
    for i in range(len(codes)):
        slot = code_below(coder, slots[i] - first, count) if spread else 0
        codes[i] = (codes[i] << size) | slot_of((first + slot) & ((1 << size) - 1), size)


@njit(borrows=True, error_model="numpy")
@no_type_check
def _code_place(coder, row, cell, place, cells_at, shift, absolute):
    """Codes the bits of a place between the first grid and the Gaussian's own step."""
    low = min(cells_at, shift)
    for a in range(3):
        fine = (cell[a] << (cells_at - low)) | code_raw(coder, place[a] >> low, cells_at - low)
        if absolute:
            fine, row[LATTICE + a] = fine >> (shift - low), 1 << shift
            row[LATTICE + a] |= fine << (shift + 1)
        else:
            row[LATTICE + a] = (fine << (low + 1)) | (1 << low)


@njit(borrows=True, error_model="numpy")
@no_type_check
def _code_spin(coder, row, axes, primary, bits):
    """Codes the turn about the primary axis, from 0 to pi in `1 << bits` steps, as it is."""
    value = np.int64(0)
    if not coder.decoding:
        value = np.int64(np.rint(_turn(row, axes, primary) / np.pi * (1 << bits))) & ((1 << bits) - 1)
    row[SPIN_BITS], row[SPIN] = bits, code_raw(coder, value, bits)


@njit(borrows=True, error_model="numpy")
@no_type_check
def _turn(row, axes, primary):
    """Angle from the frame that `attributes.frames` builds on a decoded axis to the axis after the primary one.

    Number by number: with `np.cross` and sums of arrays it takes numba seconds more to compile.
    """
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


@njit(borrows=True, error_model="numpy")
@no_type_check
def _code_packet(coder, stream, box_bits, defaults, source, rows, harmonics, scratch):
    """Codes one packet; `source` is (codes, places, classes, logs, axes, colours, harmonics) of an encoder."""
    bases, unit, coarsest, thinness = stream
    absolute = coarsest >= 0
    cells_at, spread, codes, places, classes, logs, axes, colours, levels = source
    cells, packed, stack, who, weight, axis, other = scratch
    n = len(rows)
    at = code_raw(coder, cells_at, CELLS_AT_BITS)
    at = min(max(at, box_bits - MAX_CELL_BITS), box_bits)
    if not coder.decoding:
        for i in range(n):
            packed[i] = codes[i] >> (3 * (at - max(box_bits - MAX_CELL_BITS, 0)))
    _code_codes(coder, packed, 3 * (box_bits - at), spread, cells[:, 0], stack)
    _spread_cells(packed, cells, box_bits - at)
    for i in range(n):
        j = 0 if coder.decoding else i
        count = find_neighbours(cells, i, who, weight)
        near = who[:count], weight[:count]
        rows[i, CLASS] = level = code_class(coder, rows, classes[j], near)
        s0, long, thin, opacity, running = code_logs(
            coder, rows, i, logs[j], bases, defaults, level, near, thinness, absolute
        )  # fmt: skip
        area = 2 * s0 - long
        shift = place_shift(bases, level, s0, long, thin, opacity, unit, coarsest if absolute else box_bits)
        _code_place(coder, rows[i], cells[i], places[j], at, shift, absolute)
        rows[i, PRIMARY] = primary = 2 if thin >= long else 0
        e = exponent(bases, S_DIRECTION, level, area, long, thin, opacity)
        shift = min(max(DIRECTION_BITS - e, 0), DIRECTION_BITS - 2)
        exact = axes[j, :, primary]
        running = code_axis(coder, rows, i, primary, exact, shift, near, running, axis, other, absolute)
        e = exponent(bases, S_SPIN, level, area, long, thin, opacity)
        _code_spin(coder, rows[i], axes[j], primary, min(max(e, 0), DIRECTION_BITS))
        code_colour(coder, rows, i, colours[j], bases, defaults, level, near, running, absolute)
        if harmonics.shape[1]:
            code_harmonics(coder, harmonics, i, levels, bases, level)


@njit(error_model="numpy")
@no_type_check
def new_scratch(n):
    """Room to code a packet of n: cells, their codes, the stack of `code_cells`, neighbours, weights, two axes."""
    return (
        np.empty((n, 3), np.int64),
        np.zeros(n, np.int64),
        np.empty((66, 5), np.int64),
        np.empty(NUM_NEIGHBOURS, np.int64),
        np.empty(NUM_NEIGHBOURS, np.int64),
        np.empty(3, np.int64),
        np.empty(3, np.int64),
    )


@njit(error_model="numpy")
@no_type_check
def _encode_packet(tables, stream, models, statistics, box_bits, defaults, source, buffer, rows, harmonics):
    coder = new_coder(ENCODING, buffer, ZERO, models.copy(), statistics, tables)
    encoder_start(coder.state)
    _code_packet(coder, stream, box_bits, defaults, source, rows, harmonics, new_scratch(len(rows)))
    return encoder_finish(buffer, coder.state)


@njit(error_model="numpy")
@no_type_check
def _part(source, begin, n):
    """Sources of a packet, sorted by their codes."""
    order = begin + np.argsort(source[2][begin : begin + n], kind="mergesort")
    cells_at, spread, codes, places, classes, logs, axes, colours, levels = source
    return (
        cells_at,
        spread,
        codes[order],
        places[order],
        classes[order],
        logs[order],
        axes[order],
        colours[order],
        levels[order],
    )


@njit(nogil=True, error_model="numpy")
@no_type_check
def encode_fixed(tables, stream, models, statistics, box_bits, defaults, source, sizes, buffer, rows, harmonics, ends):
    """Encodes the packets of one block, whose sizes are given; payload p ends at `ends[p]` of the buffer."""
    begin, at = 0, 0
    for p in range(len(sizes)):
        end = begin + sizes[p]
        at += _encode_packet(
            tables, stream, models, statistics, box_bits, defaults, _part(source, begin, sizes[p]),
            buffer[at:], rows[begin:end], harmonics[begin:end],
        )  # fmt: skip
        ends[p] = at
        begin = end


@njit(nogil=True, error_model="numpy")
@no_type_check
def encode_cut(
    tables, stream, models, statistics, box_bits, defaults, source, most, buffer, rows, harmonics, sizes, ends
):
    """Encodes one block in packets of at most `most` bytes, as many Gaussians to each as fit.

    A Gaussian that does not fit alone makes a packet of its own that is too large. Returns the number of packets.
    """
    total, begin, at, packets = len(rows), 0, 0, 0
    aim = most - (most >> AIM)
    guess = max(most // FIRST, 1)
    while begin < total:
        left = total - begin
        low, high, tries, last, length = 0, left + 1, 0, 0, 0
        n = min(guess, left)
        while high - low > 1:
            length = _encode_packet(
                tables, stream, models, statistics, box_bits, defaults, _part(source, begin, n),
                buffer[at:], rows[begin : begin + n], harmonics[begin : begin + n],
            )  # fmt: skip
            tries, last = tries + 1, n
            if length <= most or n == 1:
                low = n
                if n == left or length >= most - (most >> ENOUGH) or tries > 6:
                    break
            else:
                high = n
            n = min(max(n * aim // max(length, 1), low + 1), high - 1)
        if last != low:
            length = _encode_packet(
                tables, stream, models, statistics, box_bits, defaults, _part(source, begin, low),
                buffer[at:], rows[begin : begin + low], harmonics[begin : begin + low],
            )  # fmt: skip
        at += length
        sizes[packets], ends[packets] = low, at
        begin += low
        guess = max(begin * aim // max(at, 1), 1)
        packets += 1
    return packets


@njit(nogil=True, error_model="numpy")
@no_type_check
def decode_packets(tables, stream, models, data, ends, starts, box_bits, defaults, rows, harmonics):
    """Decodes packets; packet p has the rows `starts[p]:starts[p + 1]` and bytes `ends[p]:ends[p + 1]`."""
    statistics = np.zeros((1, 2), np.int64), np.zeros((1, 1, 1, 2), np.int64)
    one, three, four = np.zeros(1, np.int64), np.zeros((1, 3), np.int64), np.zeros((1, 4), np.int64)
    source = (ZERO, ZERO, one, three, one, four, np.zeros((1, 3, 3)), three, three)
    for p in range(len(starts) - 1):
        begin, end = starts[p], starts[p + 1]
        coder = new_coder(DECODING, data, ends[p + 1], models.copy(), statistics, tables)
        decoder_start(data, ends[p], ends[p + 1], coder.state)
        _code_packet(
            coder,
            stream,
            box_bits[p],
            defaults[p],
            source,
            rows[begin:end],
            harmonics[begin:end],
            new_scratch(end - begin),
        )
