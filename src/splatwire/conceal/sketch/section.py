"""The section `sketch` of the side information: coarse descriptions of the anchors that matter most.

A sketched anchor has a level. Its features and the logarithms of its scalings over those that the prior expects are
`mean + basis @ integers`, its offsets `offset_step * integers`, its mask is given; basis and offset step halve from
level to level. The basis is that in which errors of a given length change the pictures alike, and in which the columns
do not correlate.

Layout: version, number of levels, columns C and offsets per anchor, `u8`; anchors and sketched anchors, `u32`; offset
step, exponent and largest excess of the growth, trust in the scene-free network, `f32`; as `f16` the mean of the D
channels (features, and logarithms of scalings over the prior's) and a scale for each column; the scale index of each
column, and the columns of the basis, integers of at most 7 bits under a zero-mean normal of that scale. The rest is
one run of the range coder. For each anchor by rank the bit "sketched" (context: bucket of the size that the prior
expects, and how many of the four anchors before are sketched, at most 3) and its level in unary. For each sketched
anchor: its mask bits (context: offset and how many bits were 1, at most 3); C integers and three for each offset that
exists: a bit "not 0", the sign, the magnitude less one in unary up to 14 and beyond that in Elias gamma. "Not 0" and
the first four bits of the magnitude have models for each level and column (or axis), the others for each level.
Buckets are by rank of the product of the prior's last three mean scalings: the largest 1 %, then up to 3, 10, 25, 50
%, and the rest.
"""

import struct
from dataclasses import dataclass

import numpy as np

from splatwire.byte_io import ByteReader, ByteWriter
from splatwire.entropy.coder import decode_symbols, encode_symbols, fresh_models
from splatwire.entropy.integers import scale_index, zero_mean_rows
from splatwire.entropy.tables import NUM_SCALES
from splatwire.errors import BitstreamError, InvalidValueError, TruncatedStreamError, UnsupportedVersionError

SECTION = "sketch"
VERSION = 2
"""Version 1 had no trust. A sketch is made again in a minute, so it is not read any more."""
MAX_LEVELS = 8
MAX_VALUE = 1 << 24
MAX_DIRECTION = 127
MAX_TRUST = 4.0
OFFSET_STEPS = (1.0 / (1 << 13), 16.0)
"""Smallest and largest offset step; numbers that a float32 holds."""
SCALING_COLUMNS = 6
_HEADER = struct.Struct("<BBBBIIffff")
_BUCKET_SHARES = (0.01, 0.03, 0.1, 0.25, 0.5)
"""Anchors are sorted by the size that the prior expects; large ones are more likely to be sketched."""
NUM_BUCKETS = len(_BUCKET_SHARES) + 1


@dataclass(frozen=True)
class SketchSizes:
    """What a receiver knows before it reads a sketch: sizes of the scene.

    Attributes:
        num_anchors: N.
        feature_dim: F.
        num_offsets: K.
    """

    num_anchors: int
    feature_dim: int
    num_offsets: int

    @property
    def num_channels(self) -> int:
        """Features and logarithms of scalings over the expected ones, D."""
        return self.feature_dim + SCALING_COLUMNS


@dataclass(frozen=True, eq=False)
class SketchBasis:
    """How integers become attributes.

    Attributes:
        mean: float32 (D), half-precision numbers.
        directions: int16 (D, C), each column what a one at the first level adds, in units of the column's scale.
        scales: float32 (C), half-precision numbers.
        offset_step: What a one at the first level adds to a coordinate of an offset.
        num_levels: Levels; steps halve from each to the next.
    """

    mean: np.ndarray
    directions: np.ndarray
    scales: np.ndarray
    offset_step: float
    num_levels: int

    def channels(self, levels: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Features and logarithms of relative scalings, float32 (M, D), of integers (M, C) at levels (M)."""
        step = 0.5 ** (levels.astype(np.float64) - 1)
        scaled = values.astype(np.float64) * step[:, None]
        matrix = self.directions.astype(np.float64) * self.scales.astype(np.float64)
        return (self.mean.astype(np.float64) + scaled @ matrix.T).astype(np.float32)

    def offsets(self, levels: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Offsets, float32 (M, 3 K), of integers (M, 3 K) at levels (M)."""
        step = self.offset_step * 0.5 ** (levels.astype(np.float64) - 1)
        return (values.astype(np.float64) * step[:, None]).astype(np.float32)


@dataclass(frozen=True, eq=False)
class SketchSection:
    """All that the section holds.

    Attributes:
        exponent: Of the growth of what is there (`splatwire.conceal.Grow`).
        max_excess: Limit of that growth.
        trust: How much of the scene-free network's correction of the growth is taken (`splatwire.conceal.SceneFree`).
        basis: How integers become attributes.
        levels: int64 (N), 0 where an anchor is not sketched.
        masks: uint8 (M, K), sketched anchors by rank.
        values: int64 (M, C).
        offsets: int64 (M, 3 K), 0 where masked out.
    """

    exponent: float
    max_excess: float
    trust: float
    basis: SketchBasis
    levels: np.ndarray
    masks: np.ndarray
    values: np.ndarray
    offsets: np.ndarray


def size_buckets(expected_size: np.ndarray) -> np.ndarray:
    """Sorts anchors into buckets by the size that the prior expects, largest first.

    Args:
        expected_size: float (N), alike on all machines.

    Returns:
        int64 (N), 0 for the largest.
    """
    order = np.argsort(-expected_size, kind="stable")
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    edges = [int(share * len(order)) for share in _BUCKET_SHARES]
    return np.searchsorted(np.array(edges), place, side="right").astype(np.int64)


def write_sketch(section: SketchSection, buckets: np.ndarray) -> bytes:
    """Writes a sketch.

    Args:
        section: The sketch.
        buckets: int64 (N), of `size_buckets`.

    Raises:
        InvalidValueError: If it holds more than the format does.
    """
    from splatwire.conceal.sketch import _kernels as kernels
    from splatwire.entropy.range_kernels import encoder_finish, encoder_start

    basis, columns = section.basis, section.values.shape[1]
    chosen = section.levels > 0
    numbers = [basis.offset_step, section.exponent, section.max_excess, section.trust, *basis.mean, *basis.scales]
    numbers = [*numbers, *basis.mean.astype(np.float16), *basis.scales.astype(np.float16)]
    small = max(np.abs(section.values).max(initial=0), np.abs(section.offsets).max(initial=0)) < MAX_VALUE
    rows = len(section.values) == len(section.masks) == len(section.offsets) == int(chosen.sum())
    steps = OFFSET_STEPS[0] <= basis.offset_step <= OFFSET_STEPS[1]
    if not (small and rows and steps and np.isfinite(numbers).all() and basis.num_levels <= MAX_LEVELS):
        raise InvalidValueError("a sketch of this kind is beyond the format")
    header = _HEADER.pack(
        VERSION, basis.num_levels, columns, section.masks.shape[1], len(section.levels), len(section.values),
        basis.offset_step, section.exponent, section.max_excess, section.trust,
    )  # fmt: skip
    per_row = section.masks.shape[1] * kernels.BYTES_PER_BIT + kernels.BYTES_PER_VALUE * (
        columns + section.offsets.shape[1]
    )
    room = len(section.levels) * kernels.BYTES_PER_BIT * (1 + basis.num_levels) + len(section.values) * per_row + 64
    buffer, state = np.empty(room, dtype=np.uint8), np.empty(3, dtype=np.int64)
    level_models, bit_models, models = _models(basis.num_levels, columns, section.masks.shape[1])
    encoder_start(state)
    kernels.encode_levels(buffer, state, level_models, section.levels, buckets, basis.num_levels)
    kernels.encode_rows(
        buffer, state, bit_models, models, section.levels[chosen], section.masks, section.values, section.offsets
    )
    length = encoder_finish(buffer, state)
    tables = basis.mean.astype("<f2").tobytes() + basis.scales.astype("<f2").tobytes()
    return header + tables + _write_directions(basis.directions) + buffer[:length].tobytes()


def read_sketch(data: bytes, sizes: SketchSizes, buckets: np.ndarray) -> SketchSection:
    """Reads a sketch; the inverse of `write_sketch`.

    Args:
        data: The section.
        sizes: Sizes of the scene that it belongs to.
        buckets: int64 (N), of `size_buckets`.

    Raises:
        UnsupportedVersionError: If another release wrote it, in a version that this one does not read.
        BitstreamError: If it is damaged, or of another scene.
    """
    from splatwire.conceal.sketch import _kernels as kernels
    from splatwire.entropy.range_kernels import decoder_start

    growth, count, basis, coded = _read_head(data, sizes)
    columns = basis.directions.shape[1]
    state, levels = np.empty(3, dtype=np.int64), np.empty(sizes.num_anchors, dtype=np.int64)
    level_models, bit_models, models = _models(basis.num_levels, columns, sizes.num_offsets)
    decoder_start(coded, 0, len(coded), state)
    found = kernels.decode_levels(coded, state, level_models, buckets, basis.num_levels, levels)
    if found != count:  # before memory is taken for the rows
        raise BitstreamError(f"section '{SECTION}': {found} anchors are sketched, and {count} should be")
    masks = np.empty((count, sizes.num_offsets), dtype=np.uint8)
    values = np.empty((count, columns), dtype=np.int64)
    offsets = np.empty((count, 3 * sizes.num_offsets), dtype=np.int64)
    kernels.decode_rows(coded, state, bit_models, models, levels[levels > 0], masks, values, offsets)
    if max(np.abs(values).max(initial=0), np.abs(offsets).max(initial=0)) >= MAX_VALUE:
        raise BitstreamError(f"section '{SECTION}' is damaged: values out of range")
    return SketchSection(*growth, basis, levels, masks, values, offsets)


def _read_head(data: bytes, sizes: SketchSizes) -> tuple[tuple[float, float, float], int, SketchBasis, np.ndarray]:
    """Checks everything in front of the coded part; returns it (first exponent, limit, trust) with the coded part."""
    if data and data[0] != VERSION:
        raise UnsupportedVersionError(
            f"section '{SECTION}' has version {data[0]}, this release reads {VERSION}: make it again with "
            "`splatwire calibrate sketch`"
        )
    if len(data) < _HEADER.size:
        raise TruncatedStreamError(f"section '{SECTION}' has {len(data)} bytes, its header takes {_HEADER.size}")
    _, num_levels, columns, offsets, anchors, count, offset_step, *growth = _HEADER.unpack_from(data)
    if (anchors, offsets) != (sizes.num_anchors, sizes.num_offsets):
        raise BitstreamError(f"section '{SECTION}' is of a scene of {anchors} anchors with {offsets} offsets")
    reader = ByteReader(data[_HEADER.size :], f"section '{SECTION}'")
    numbers = np.frombuffer(reader.take(2 * (sizes.num_channels + columns)), dtype="<f2").astype(np.float32)
    sane = 1 <= num_levels <= MAX_LEVELS and 1 <= columns <= sizes.num_channels and count <= anchors
    exponent, excess, trust = growth
    sane = sane and OFFSET_STEPS[0] <= offset_step <= OFFSET_STEPS[1]
    sane = sane and 0 <= exponent <= 4 and 1 <= excess <= 16 and 0 <= trust <= MAX_TRUST
    if not (sane and np.isfinite(numbers).all()):
        raise BitstreamError(f"section '{SECTION}' is damaged: its header or its tables are impossible")
    directions = _read_directions(reader, sizes.num_channels, columns)
    mean, scales = numbers[: sizes.num_channels], numbers[sizes.num_channels :]
    basis = SketchBasis(mean, directions, scales, offset_step, num_levels)
    return (exponent, excess, trust), count, basis, np.frombuffer(reader.rest(), dtype=np.uint8)


def _write_directions(directions: np.ndarray) -> bytes:
    """Codes the columns, each under a normal of its own."""
    scales = scale_index(np.sqrt((directions.astype(np.float64) ** 2).mean(axis=0) + 0.05))
    writer = ByteWriter()
    for scale in scales.tolist():
        writer.unsigned(scale)
    writer.blob(encode_symbols(directions.T.ravel().astype(np.int64), zero_mean_rows(scales, len(directions))))
    return writer.bytes()


def _read_directions(reader: ByteReader, channels: int, columns: int) -> np.ndarray:
    scales = np.array([reader.unsigned() for _ in range(columns)], dtype=np.int64)
    if scales.max(initial=0) >= NUM_SCALES:
        raise BitstreamError(f"section '{SECTION}' is damaged: a scale of its basis is impossible")
    symbols = decode_symbols(reader.blob(), zero_mean_rows(scales, channels))
    if np.abs(symbols).max(initial=0) > MAX_DIRECTION:
        raise BitstreamError(f"section '{SECTION}' is damaged: its basis is impossible")
    return symbols.reshape(columns, channels).T.astype(np.int16)


def _models(num_levels: int, columns: int, num_offsets: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fresh adaptive models of levels, masks and values."""
    from splatwire.conceal.sketch import _kernels as kernels

    values = num_levels * ((columns + 3) * (1 + kernels.OWN) + kernels.SHARED)
    return (
        fresh_models(NUM_BUCKETS * kernels.HISTORY + num_levels),
        fresh_models(num_offsets * kernels.HISTORY),
        fresh_models(values),
    )
