"""Side information of explicit Gaussians, sent before the packets (docs/format.md)."""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from splatwire.bitstream.limits import GAUSSIANS, MAX_DEGREE, MAX_SIZE_LOG, SCHEMAS
from splatwire.bitstream.sections import read_sections, write_sections
from splatwire.codec._residual_kernels import residual_distributions
from splatwire.codec.gaussians.blocks import BOX_BITS, Boxes
from splatwire.codec.gaussians.layout import (
    BITS,
    FIRST_HARMONIC,
    MAX_CLASSES,
    MAX_LATTICE_BITS,
    NUM_CONTEXTS,
    NUM_DEVIATION_CONTEXTS,
    NUM_MAGNITUDE_CONTEXTS,
    RESIDUAL_KINDS,
    SCALE_INDEX_STEP,
    STEP_BITS,
    STEP_HARMONICS,
    STEPS,
    TRANSFORM_UNIT,
)
from splatwire.codec.gaussians.tables import flatness_table
from splatwire.entropy.coder import decode_bits, encode_bits, fresh_models, tables
from splatwire.entropy.integers import read_integers, write_integers
from splatwire.entropy.tables import NUM_SCALES
from splatwire.errors import BitstreamError, UnsupportedVersionError
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.types import SplatCoding

VERSION = 3
RELATIVE_VERSION = 2
"""Version of the side information of older streams, whose decoded integers depend on the division into packets: each
integer is the prediction from neighbours in the same packet plus a multiple of the quantisation step.
"""
NUM_BLOCK_MEANS = 7
MEAN_SHIFT = BITS - 4
"""log2 of the step of the mean attributes of blocks, in fixed point with `BITS` fractional bits; this step is 1/16."""
MAX_MEAN = 511 << MEAN_SHIFT
"""Largest magnitude of a mean attribute of a block that an encoder writes."""
TABLE_SHAPE = (len(RESIDUAL_KINDS), NUM_DEVIATION_CONTEXTS, NUM_MAGNITUDE_CONTEXTS)


@dataclass(frozen=True, eq=False)
class SideInfo:
    """Side information of a stream of explicit Gaussians: data shared by all packets.

    Attributes:
        degree: Degree of the spherical harmonics.
        size_log: log2 of the scene size: the median distance of the Gaussians from their median position, rounded down
            to a power of two, in world units (`log2_scene_size`).
        lattice_bits: Resolution of positions. Positions are multiples of half a lattice spacing; the spacing is
            `2 ** (size_log - lattice_bits)` world units.
        base_exponents: int64 (9), `-log2` of the quantisation step of each quantity in `layout.STEPS`, for precision
            class 0 (the coarsest) and a Gaussian with scales (relative to the scene size) and opacity 1, in fixed
            point with `STEP_BITS` fractional bits. `layout.COEFFICIENTS` adapts the steps to other Gaussians.
        max_position_shift: log2 of the largest quantisation step of positions, in lattice spacings; -1 in side
            information of version 2, which has no such limit (see `packet_dependent`).
        transform: int64 (K, K), decorrelating transform of the spherical harmonics, one axis per row, with denominator
            `TRANSFORM_UNIT`.
        boxes: Bounding boxes of the B blocks.
        block_means: int64 (B, 7), means over each block, before quantisation, of the columns `OPACITY`, `SCALE0`,
            `ELONGATION` and `FLATNESS` (see `layout.COLUMNS`) and of Y Co Cg, in fixed point (`BITS` fractional bits),
            multiples of `1 << MEAN_SHIFT`.
        zero_probabilities: int64 (contexts), initial probability that a bit is 0, for each adaptive bit model, out of
            2**8.
        scale_indices: int64 (A, B, C), index of the standard deviation of residuals in the coder's table, for each
            context, a multiple of `SCALE_INDEX_STEP`. A context has three indices (see `Coder`).
        sections: Named sections, content by name.
    """

    degree: int
    size_log: int
    lattice_bits: int
    base_exponents: np.ndarray
    max_position_shift: int
    transform: np.ndarray
    boxes: Boxes
    block_means: np.ndarray
    zero_probabilities: np.ndarray
    scale_indices: np.ndarray
    sections: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def packet_dependent(self) -> bool:
        """True if decoded integers depend on the division into packets (`RELATIVE_VERSION`)."""
        return self.max_position_shift < 0

    @property
    def num_harmonic_columns(self) -> int:
        """Number of quantised harmonic coefficients per Gaussian: 3 K, for K harmonics above degree 0."""
        return 3 * ((self.degree + 1) ** 2 - 1)

    @property
    def kernel_tables(self) -> tuple[np.ndarray, ...]:
        """Tables of the entropy coder, in the order in which compiled kernels take them as arguments."""
        return (*_residual_tables(self.scale_indices.tobytes()), *tables())

    def step_parameters(self) -> tuple[np.ndarray, int, int, np.ndarray]:
        """Returns the parameters that compiled kernels need to compute quantisation steps.

        Returns:
            The attributes `base_exponents`, `lattice_bits` and `max_position_shift`, and the result of
            `flatness_table`.
        """
        return self.base_exponents, self.lattice_bits, self.max_position_shift, flatness_table()

    def models(self) -> np.ndarray:
        """Returns the initial state of the adaptive bit models, equal for all packets, int64 (contexts, 2)."""
        return np.repeat(self.zero_probabilities[:, None] << 8, 2, axis=1)

    @functools.cached_property
    def harmonics_inverse(self) -> tuple[np.ndarray, np.ndarray]:
        """Matrix and thresholds with which an encoder transforms the K spherical harmonics above degree 0.

        The matrix is the inverse of `transform`, float64 (K, columns). The K harmonics of a colour component,
        multiplied by column k, give transformed harmonic k. The columns from K on are 0: they make the number of
        columns a multiple of 8, for vector instructions.

        There is one threshold for each precision class (set of quantisation steps), in units of `2 ** -BITS`, float64
        (`MAX_CLASSES`). If the Euclidean length of the K harmonics of a colour component is below the threshold,
        quantisation makes all transformed harmonics of this component 0. The encoder then need not compute them.
        """
        num_harmonics = len(self.transform)
        inverse = np.zeros((num_harmonics, -(-num_harmonics // 8) * 8))
        inverse[:, :num_harmonics] = np.linalg.inv(self.transform / TRANSFORM_UNIT) if num_harmonics else 0
        max_length = np.sqrt(np.square(inverse).sum(axis=0).max(initial=1e-30))
        # A tolerance covers rounding errors of the product.
        exponents = self.base_exponents[STEP_HARMONICS] / (1 << STEP_BITS) + np.arange(MAX_CLASSES)
        steps = 2.0 ** np.clip(BITS - np.floor(exponents + 0.5), 0, BITS - 2)
        return inverse, (np.maximum(steps / 2, 1.0) - 0.5001) / max_length


@functools.lru_cache(maxsize=8)  # of megabytes each, and a stream may have thousands
def _residual_tables(scale_indices: bytes) -> tuple[np.ndarray, ...]:
    """Computes the probability tables of residuals.

    Args:
        scale_indices: `SideInfo.scale_indices`, an int64 array converted to bytes.
    """
    return tuple(residual_distributions(np.frombuffer(scale_indices, np.int64), *tables()))


def write_side_info(info: SideInfo) -> bytes:
    """Serialises the side information of a stream of Gaussians."""
    writer = ByteWriter()
    for part in (write_header(info), write_blocks(info.boxes, info.block_means), _write_contexts(info)):
        writer.blob(part)
    return writer.bytes() + write_sections(info.sections)


def read_side_info(data: bytes, num_blocks: int) -> SideInfo:
    """Reads side information serialised by `write_side_info`.

    Args:
        data: The serialised side information.
        num_blocks: Number of blocks in the packet plan, from the manifest.

    Raises:
        UnsupportedVersionError: If a newer release wrote the side information.
        BitstreamError: If the bytes are damaged or are not side information of such a stream.
    """
    reader = ByteReader(data, "side information")
    header, blocks, contexts = (reader.blob() for _ in SCHEMAS[GAUSSIANS].sections)
    sections = read_sections(reader.rest())
    fields = read_header(header)
    boxes, block_means = read_blocks(blocks, num_blocks)
    return SideInfo(*fields, boxes, block_means, *_read_contexts(contexts, fields[0]), sections)


def write_header(parameters: SideInfo | SplatCoding) -> bytes:
    """Serialises the quantisation parameters and the transform of the spherical harmonics.

    Args:
        parameters: Object with these parameters as attributes.
    """
    writer = ByteWriter()
    writer.u8(RELATIVE_VERSION if parameters.max_position_shift < 0 else VERSION)
    writer.u8(math.isqrt(len(parameters.transform) + 1) - 1)
    writer.signed(parameters.size_log)
    writer.signed(parameters.lattice_bits)
    for base in map(int, parameters.base_exponents):
        writer.signed(base)
    if parameters.max_position_shift >= 0:
        writer.u8(parameters.max_position_shift)
    return writer.bytes() + np.asarray(parameters.transform).astype(np.int8).tobytes()


def read_header(data: bytes) -> tuple[int, int, int, np.ndarray, int, np.ndarray]:
    """Reads quantisation parameters serialised by `write_header`.

    Returns:
        The fields `degree`, `size_log`, `lattice_bits`, `base_exponents`, `max_position_shift` and `transform` of
        `SideInfo`.

    Raises:
        UnsupportedVersionError: If a newer release wrote the header.
        BitstreamError: If the bytes are damaged or are not such a header.
    """
    reader = ByteReader(data, "side information header")
    version = reader.u8()
    if version not in (RELATIVE_VERSION, VERSION):
        raise UnsupportedVersionError(
            f"side information has version {version}, this release reads versions {RELATIVE_VERSION} and {VERSION}"
        )
    degree, size_log, lattice_bits = reader.u8(), reader.signed(), reader.signed()
    base_exponents = np.array([reader.signed() for _ in STEPS], dtype=np.int64)
    max_position_shift = -1 if version == RELATIVE_VERSION else reader.u8()
    transform = reader.rest()
    if degree > MAX_DEGREE or abs(size_log) > MAX_SIZE_LOG or not 0 <= lattice_bits <= MAX_LATTICE_BITS:
        raise BitstreamError(
            f"side information: degree {degree}, size {size_log} or lattice bits {lattice_bits} are impossible"
        )
    if max_position_shift > MAX_LATTICE_BITS:
        raise BitstreamError(f"side information: position steps of 2**{max_position_shift} units are impossible")
    if np.abs(base_exponents).max() > 64 << STEP_BITS:
        raise BitstreamError(f"side information: impossible steps {base_exponents.tolist()}")
    num_harmonics = (degree + 1) ** 2 - 1
    if len(transform) != num_harmonics**2:
        raise BitstreamError(f"side information: a transform of {len(transform)} entries, not {num_harmonics**2}")
    return (
        degree,
        size_log,
        lattice_bits,
        base_exponents,
        max_position_shift,
        np.frombuffer(transform, np.int8).astype(np.int64).reshape(num_harmonics, num_harmonics),
    )


def write_blocks(boxes: Boxes, block_means: np.ndarray) -> bytes:
    """Serialises the bounding boxes and mean attributes of the blocks of a stream.

    Args:
        boxes: Bounding boxes of the B blocks.
        block_means: int64 (B, 7), means of the coded quantities of each block (see `SideInfo.block_means`).
    """
    writer = ByteWriter()
    for shift, corner, extent in zip(boxes.shifts, boxes.grid_corners, boxes.extents, strict=True):
        writer.u8(int(shift))
        for value in corner.tolist():
            writer.signed(value)
        for value in extent.tolist():
            writer.u8(value)
    for column in block_means.T:
        write_integers(writer, column >> MEAN_SHIFT)
    return writer.bytes()


def read_blocks(data: bytes, num_blocks: int) -> tuple[Boxes, np.ndarray]:
    """Reads bounding boxes and mean attributes of blocks, serialised by `write_blocks`.

    Args:
        data: The serialised boxes and means.
        num_blocks: Number of blocks, B.

    Returns:
        The boxes, and the means of the coded quantities of each block, int64 (B, 7) (see `SideInfo.block_means`).

    Raises:
        BitstreamError: If the bytes are damaged or do not match the number of blocks.
    """
    reader = ByteReader(data, "side information blocks")
    if num_blocks * 7 > len(data):
        raise BitstreamError(f"side information: {len(data)} bytes cannot hold {num_blocks} boxes")
    shifts = np.zeros(num_blocks, dtype=np.int64)
    boxes = np.zeros((num_blocks, 6), dtype=np.int64)
    for block in range(num_blocks):
        shifts[block] = reader.u8()
        boxes[block] = [*(reader.signed() for _ in range(3)), *(reader.u8() for _ in range(3))]
    if shifts.max(initial=0) > MAX_LATTICE_BITS - BOX_BITS or _exceeds_lattice(shifts, boxes[:, :3]):
        raise BitstreamError("side information: a block's box is impossible")
    block_means = np.stack([read_integers(reader, num_blocks) for _ in range(NUM_BLOCK_MEANS)], axis=1)
    reader.finish()
    return Boxes(shifts, boxes[:, :3], boxes[:, 3:]), np.clip(block_means, -1 << 9, 1 << 9) << MEAN_SHIFT


def _exceeds_lattice(shifts: np.ndarray, grid_corners: np.ndarray) -> bool:
    return bool((np.abs(grid_corners) > (1 << MAX_LATTICE_BITS) >> shifts[:, None]).any())


def _num_contexts(degree: int) -> int:
    return NUM_CONTEXTS if degree else FIRST_HARMONIC


def _write_contexts(info: SideInfo) -> bytes:
    """Serialises the initial probability tables of the entropy coder."""
    # A probability is one byte. A difference of indices is a flag, and the number itself if it is not 0.
    writer, steps = ByteWriter(), np.diff(info.scale_indices // SCALE_INDEX_STEP, axis=2, prepend=0)
    writer.blob(bytes(info.zero_probabilities[: _num_contexts(info.degree)].astype(np.uint8)))
    changed = (steps != 0).ravel()
    writer.blob(encode_bits(changed.astype(np.uint8), _changed_flag_contexts(), fresh_models(2)))
    write_integers(writer, steps.ravel()[changed])
    return writer.bytes()


def _read_contexts(data: bytes, degree: int) -> tuple[np.ndarray, np.ndarray]:
    reader = ByteReader(data, "side information contexts")
    zero_probabilities, stored = even_odds(), reader.blob()
    if len(stored) != _num_contexts(degree):
        raise BitstreamError(f"side information: {len(stored)} models of bits, not {_num_contexts(degree)}")
    zero_probabilities[: len(stored)] = np.frombuffer(stored, dtype=np.uint8)
    changed = decode_bits(reader.blob(), _changed_flag_contexts(), fresh_models(2)) != 0
    steps = np.zeros(changed.shape, dtype=np.int64)
    steps[changed] = read_integers(reader, int(changed.sum()))
    reader.finish()
    scale_indices = np.cumsum(steps.reshape(TABLE_SHAPE), axis=2)
    scale_indices = np.clip(scale_indices, 0, NUM_SCALES // SCALE_INDEX_STEP - 1) * SCALE_INDEX_STEP
    return np.clip(zero_probabilities, 1, 255), scale_indices


def even_odds() -> np.ndarray:
    """Returns `SideInfo.zero_probabilities` in which a bit is 0 or 1 with equal probability, int64 (contexts)."""
    return np.full(NUM_CONTEXTS, 128, dtype=np.int64)


def _changed_flag_contexts() -> np.ndarray:
    contexts = np.zeros(TABLE_SHAPE, dtype=np.int64)
    contexts[:, :, 0] = 1
    return contexts.ravel()
