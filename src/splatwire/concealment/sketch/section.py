"""Format of the section `sketch` of the side information: coarse copies of the most important anchors.

If an anchor is lost, a receiver draws its copy instead.

**Content.** Each copy has a precision level, from 1 (coarsest). Two kinds of numbers, its D channels, are coded
together: the features of the anchor, and the logarithms of its scalings divided by those that the context model
predicts. C integers per copy represent them: the channels are `mean + basis @ integers`. The columns of `basis` are the
vectors of a decorrelating transform, scaled so that an error of 1 in any integer changes the rendered pictures equally.
Offsets are `offset_step * integers`. The mask of a copy selects the offsets that it contains. From each level to the
next, `basis` and `offset_step` are halved.

**Head.** The fields in order:

* version, number of levels, C, and number of offsets per anchor, `u8` each;
* number of anchors, and number of copies, `u32` each;
* `offset_step`, `f32`;
* three parameters, `f32` each, of the enlargement of received anchors, which fills gaps of lost ones: the exponent; the
  upper limit, as a multiple of the enlargement that fits the average loss of the scene; and the weight of a correction
  that the network of the concealer `scene_free` predicts;
* the mean of the D channels, `f16`;
* a factor for each column of the basis, `f16`;
* for each column of the basis, the index of the standard deviation with which its integers are coded;
* the columns of the basis, integers of at most 7 bits, entropy-coded with zero-mean normal distributions.

**Body** (output of the range coder). First, for each anchor in coding order: a bit that is 1 if the anchor has a copy,
then the level in unary. The context is the size class of the anchor and the number of copies among the four anchors
before, at most 3. Anchors are sorted by the product of the last three scalings, as predicted from the hash grid,
largest first. The first size class ends at 1 % of the anchors, the next ones at 3, 10, 25 and 50 %; the rest is the
last one.

Then, for each copy: the bits of its mask (context: offset, and number of 1 bits before, at most 3), its C integers, and
three integers per existing offset. An integer consists of a bit that is 0 for the integer 0, the sign, and the
magnitude less one, in unary up to 14 and in Elias gamma code beyond. The first bit and the first four bits of the
magnitude have probability models per level and column (or axis), other bits per level.
"""

import struct
from dataclasses import dataclass

import numpy as np

from splatwire.entropy.coder import decode_symbols, encode_symbols, fresh_models
from splatwire.entropy.integers import scale_index, zero_mean_rows
from splatwire.entropy.tables import NUM_SCALES
from splatwire.errors import BitstreamError, InvalidValueError, TruncatedStreamError, UnsupportedVersionError
from splatwire.files.byte_io import ByteReader, ByteWriter

SECTION = "sketch"
VERSION = 2
"""Version of the layout. Version 1 lacked the field `trust` and is no longer read; a sketch can be recreated in a
minute."""
MAX_LEVELS = 8
MAX_VALUE = 1 << 24
MAX_DIRECTION = 127
MAX_TRUST = 4.0
OFFSET_STEPS = (1.0 / (1 << 13), 16.0)
"""Smallest and largest quantisation step of offsets; both are exact in float32."""
SCALING_COLUMNS = 6
_HEADER = struct.Struct("<BBBBIIffff")
_BUCKET_SHARES = (0.01, 0.03, 0.1, 0.25, 0.5)
"""Limits of the size classes (buckets) as fractions of the anchors, sorted by predicted size. The class is a context of
the entropy coder, because large anchors have copies more often."""
NUM_BUCKETS = len(_BUCKET_SHARES) + 1


@dataclass(frozen=True)
class SketchSizes:
    """Array dimensions of a scene, for decoding coarse copies of its anchors (a sketch).

    Attributes:
        num_anchors: Number of anchors, N.
        feature_dim: Number of feature channels, F.
        num_offsets: Number of offsets per anchor, K.
    """

    num_anchors: int
    feature_dim: int
    num_offsets: int

    @property
    def num_channels(self) -> int:
        """Number of values in the coarse copy of an anchor: feature channels and six logarithms of scalings."""
        return self.feature_dim + SCALING_COLUMNS


@dataclass(frozen=True, eq=False)
class SketchBasis:
    """Basis vectors and quantisation steps for dequantising coarse copies of anchors (a sketch).

    A copy has D channels: the features, and the logarithms of scalings relative to their prediction. The channels of a
    copy are the mean plus a sum of C basis vectors, each multiplied by a coded integer.

    Attributes:
        mean: Mean of the channels, float32 (D).
        directions: Basis vectors as columns, before multiplication with `scales`, int16 (D, C).
        scales: Scale of each basis vector at the first precision level, float32 (C).
        offset_step: Quantisation step of offset coordinates at the first precision level.
        num_levels: Number of precision levels; steps halve from each level to the next.
    """

    mean: np.ndarray
    directions: np.ndarray
    scales: np.ndarray
    offset_step: float
    num_levels: int

    def channels(self, precision_levels: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Dequantises coarse copies: features, and logarithms of scalings relative to the predicted ones.

        Args:
            precision_levels: Precision level of each copied anchor, from 1, (M).
            values: Quantised transform coefficients, (M, C).

        Returns:
            float32 (M, D).
        """
        step = 0.5 ** (precision_levels.astype(np.float64) - 1)
        scaled = values.astype(np.float64) * step[:, None]
        matrix = self.directions.astype(np.float64) * self.scales.astype(np.float64)
        return (self.mean.astype(np.float64) + scaled @ matrix.T).astype(np.float32)

    def offsets(self, precision_levels: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Dequantises the offsets of coarse copies, float32 (M, 3 K).

        Args:
            precision_levels: Precision level of each copied anchor, from 1, (M).
            values: Quantised offsets, (M, 3 K).
        """
        step = self.offset_step * 0.5 ** (precision_levels.astype(np.float64) - 1)
        return (values.astype(np.float64) * step[:, None]).astype(np.float32)


@dataclass(frozen=True, eq=False)
class SketchSection:
    """Decoded content of the section `sketch`: coarse copies of anchors, and parameters of the concealer `sketch`.

    Attributes:
        exponent: Exponent of the enlargement of drawn anchors next to hidden ones
            (`splatwire.concealment.Grow.exponent`).
        max_excess: Limit of that enlargement (`Grow.max_excess`).
        trust: Factor on the correction of the enlargement by a neural network (`concealment.SceneFree.trust`).
        basis: Parameters that map the coded integers to attributes.
        levels: Precision level of each anchor's copy, int64 (N); 0 for an anchor without a copy.
        masks: Offset masks of the M copied anchors in coding order, uint8 (M, K).
        values: Quantised transform coefficients of features and scalings, int64 (M, C).
        offsets: Quantised offsets, int64 (M, 3 K); 0 where masked out.
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
    """Divides anchors into size classes, which select the contexts of the entropy coder for coarse copies.

    Args:
        expected_size: Sizes as predicted from the hash grid, float (N), identical on all machines.

    Returns:
        Class of each anchor, int64 (N), 0 for the largest.
    """
    order = np.argsort(-expected_size, kind="stable")
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    edges = [int(share * len(order)) for share in _BUCKET_SHARES]
    return np.searchsorted(np.array(edges), rank, side="right").astype(np.int64)


def write_sketch(section: SketchSection, buckets: np.ndarray) -> bytes:
    """Encodes a sketch (coarse copies of anchors) as a section of the side information.

    Args:
        section: The sketch.
        buckets: Size class of each anchor, from `size_buckets`, int64 (N).

    Raises:
        InvalidValueError: If a value is beyond the limits of the format.
    """
    from splatwire.concealment.sketch import _kernels as kernels

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
    capacity = len(section.levels) * kernels.BYTES_PER_BIT * (1 + basis.num_levels) + len(section.values) * per_row + 64
    level_models, bit_models, models = _models(basis.num_levels, columns, section.masks.shape[1])
    coder = kernels.Coder.encoder(capacity)
    kernels.code_levels(coder, level_models, section.levels.copy(), buckets, basis.num_levels)
    copies = (values.copy() for values in (section.masks, section.values, section.offsets))
    kernels.code_rows(coder, bit_models, models, section.levels[chosen], *copies)
    tables = basis.mean.astype("<f2").tobytes() + basis.scales.astype("<f2").tobytes()
    return header + tables + _write_directions(basis.directions) + coder.finish()


def read_sketch(data: bytes, sizes: SketchSizes, buckets: np.ndarray) -> SketchSection:
    """Decodes the coarse copies of anchors from the section `sketch` of the side information.

    Args:
        data: Bytes of the section.
        sizes: Numbers of anchors, of feature channels and of offsets per anchor in the scene.
        buckets: Size class of each anchor, from `size_buckets`, int64 (N).

    Raises:
        UnsupportedVersionError: If this release does not support the section's version.
        BitstreamError: If the section is damaged, or belongs to another scene.
    """
    from splatwire.concealment.sketch import _kernels as kernels

    growth, count, basis, coded = _read_head(data, sizes)
    columns = basis.directions.shape[1]
    levels = np.zeros(sizes.num_anchors, dtype=np.int64)
    level_models, bit_models, models = _models(basis.num_levels, columns, sizes.num_offsets)
    coder = kernels.Coder.decoder(coded)
    num_sketched = kernels.code_levels(coder, level_models, levels, buckets, basis.num_levels)
    if num_sketched != count:  # checked before the rows are allocated
        raise BitstreamError(f"section '{SECTION}': {num_sketched} anchors are sketched, and {count} should be")
    masks = np.zeros((count, sizes.num_offsets), dtype=np.uint8)
    values = np.zeros((count, columns), dtype=np.int64)
    offsets = np.zeros((count, 3 * sizes.num_offsets), dtype=np.int64)
    kernels.code_rows(coder, bit_models, models, levels[levels > 0], masks, values, offsets)
    if max(np.abs(values).max(initial=0), np.abs(offsets).max(initial=0)) >= MAX_VALUE:
        raise BitstreamError(f"section '{SECTION}' is damaged: values out of range")
    return SketchSection(*growth, basis, levels, masks, values, offsets)


def _read_head(data: bytes, sizes: SketchSizes) -> tuple[tuple[float, float, float], int, SketchBasis, bytes]:
    """Reads and checks the part of the section `sketch` before the entropy-coded copies of anchors.

    Args:
        data: Bytes of the section.
        sizes: Array dimensions of the scene.

    Returns:
        Four items:

        * Parameters of the enlargement of drawn anchors next to lost ones: exponent, upper limit, and strength of the
          correction by a neural network.
        * Number of anchors that have a copy.
        * Parameters for dequantising the copies.
        * The remaining bytes: the entropy-coded copies.
    """
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
    return (exponent, excess, trust), count, basis, reader.rest()


def _write_directions(directions: np.ndarray) -> bytes:
    """Entropy-codes the basis vectors of the coarse copies, each with a normal distribution of mean 0.

    Args:
        directions: Basis vectors as columns, int16 (D, C).
    """
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
    """Returns the initial bit models of the range coder for a sketch: the coarse copies of the most important anchors.

    Args:
        num_levels: Number of precision levels of copies.
        columns: Number of transform coefficients of a copy, C; they describe its features and scalings.
        num_offsets: Number of offsets per anchor, K.

    Returns:
        Three tables of adaptive bit models. The first codes which anchors have copies, and the precision levels of the
        copies. The second codes the offset masks, the third codes the transform coefficients and the offsets.
    """
    from splatwire.concealment.sketch import _kernels as kernels

    values = num_levels * ((columns + 3) * (1 + kernels.OWN) + kernels.SHARED)
    return (
        fresh_models(NUM_BUCKETS * kernels.HISTORY + num_levels),
        fresh_models(num_offsets * kernels.HISTORY),
        fresh_models(values),
    )
