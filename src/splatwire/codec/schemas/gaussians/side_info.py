"""Side information of Gaussians: steps, boxes of blocks, tables of contexts, and named sections (docs/format.md)."""

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from splatwire.byte_io import ByteReader, ByteWriter
from splatwire.codec.schemas.gaussians.blocks import BOX_BITS, Boxes
from splatwire.codec.schemas.gaussians.layout import (
    BITS,
    FIRST_HARMONIC,
    MAX_LATTICE_BITS,
    NUM_CONTEXTS,
    SCALE_UNIT,
    SECONDS,
    SPREADS,
    STEP_BITS,
    STEPS,
    STREAMS,
)
from splatwire.codec.schemas.gaussians.tables import thinness_table
from splatwire.entropy.coder import decode_bits, encode_bits, fresh_models, tables
from splatwire.entropy.integers import read_integers, write_integers
from splatwire.entropy.tables import NUM_SCALES
from splatwire.errors import BitstreamError, UnsupportedVersionError
from splatwire.model import SplatCoding
from splatwire.packets.limits import GAUSSIANS, MAX_DEGREE, MAX_SIZE_LOG, SCHEMAS
from splatwire.packets.sections import read_sections, write_sections

VERSION = 3
RELATIVE = 2
"""Version whose integers are whole steps from what neighbours in the same packet make expect."""
NUM_DEFAULTS = 7
DEFAULT_SHIFT = BITS - 4
"""Means of a block are in sixteenths."""
TABLE_SHAPE = (len(STREAMS), SPREADS, SECONDS)


@dataclass(frozen=True, eq=False)
class SideInfo:
    """What all packets of a stream share.

    Attributes:
        degree: Degree of the harmonics.
        size_log: log2 of the scene's size.
        unit: `-log2` of the lattice's unit, relative to the scene's size.
        bases: int64, by `STEPS`: `-log2` of steps of class 0, out of 2**STEP_BITS.
        coarsest: log2 of the largest cell of a place, in lattice units: all integers are multiples of their Gaussian's
            own steps, whatever packet it is in. -1 in streams of version 2, whose integers depend on their packets.
        transform: int64 (K, K), out of `TRANSFORM_UNIT`: row k says what the k-th number of a channel that a packet
            holds adds to its K harmonics.
        boxes: Boxes of the B blocks.
        defaults: int64 (B, 7), means of opacity, scales and colour of each block, in sixteenths.
        bit_zero: int64 (contexts), initial P(0) of the adaptive models, out of 2**8.
        scales: int64 (streams, spreads, seconds), narrow scales of residuals, in units of `SCALE_UNIT` entries.
        sections: Named sections, content by name.
    """

    degree: int
    size_log: int
    unit: int
    bases: np.ndarray
    coarsest: int
    transform: np.ndarray
    boxes: Boxes
    defaults: np.ndarray
    bit_zero: np.ndarray
    scales: np.ndarray
    sections: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def num_harmonics(self) -> int:
        """Coefficients of all channels but those of degree 0."""
        return 3 * ((self.degree + 1) ** 2 - 1)

    def kernel_tables(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Scales of residuals and tables of the range coder, as the kernels take them."""
        return (self.scales * SCALE_UNIT, *tables())

    def kernel_stream(self) -> tuple[np.ndarray, int, int, np.ndarray]:
        """What else is the same for all packets, as the kernels take it."""
        return self.bases, self.unit, self.coarsest, thinness_table()

    def models(self) -> np.ndarray:
        """Initial adaptive models of every packet, int64 (contexts, 2)."""
        return np.repeat(self.bit_zero[:, None] << 8, 2, axis=1)

    @functools.cached_property
    def block_defaults(self) -> np.ndarray:
        """Means of each block in fixed point, int64 (B, 7)."""
        return self.defaults << DEFAULT_SHIFT


def write_side_info(info: SideInfo) -> bytes:
    """Writes side information."""
    writer = ByteWriter()
    for part in (write_header(info), write_blocks(info.boxes, info.defaults), _contexts(info)):
        writer.blob(part)
    return writer.bytes() + write_sections(info.sections)


def read_side_info(data: bytes, num_blocks: int) -> SideInfo:
    """Reads side information; the inverse of `write_side_info`.

    Args:
        data: The bytes.
        num_blocks: Blocks of the plan (from the manifest).

    Raises:
        UnsupportedVersionError: If a newer release wrote it.
        BitstreamError: If the bytes are damaged or something else.
    """
    reader = ByteReader(data, "side information")
    header, blocks, contexts = (reader.blob() for _ in SCHEMAS[GAUSSIANS].sections)
    sections = read_sections(reader.rest())
    fields = read_header(header)
    boxes, defaults = read_blocks(blocks, num_blocks)
    return SideInfo(*fields, boxes, defaults, *_read_contexts(contexts, fields[0]), sections)


def write_header(of: SideInfo | SplatCoding) -> bytes:
    """Writes the steps that Gaussians are rounded to."""
    writer = ByteWriter()
    writer.u8(RELATIVE if of.coarsest < 0 else VERSION)
    writer.u8(math.isqrt(len(of.transform) + 1) - 1)
    writer.signed(of.size_log)
    writer.signed(of.unit)
    for base in map(int, of.bases):
        writer.signed(base)
    if of.coarsest >= 0:
        writer.u8(of.coarsest)
    return writer.bytes() + np.asarray(of.transform).astype(np.int8).tobytes()


def read_header(data: bytes) -> tuple[int, int, int, np.ndarray, int, np.ndarray]:
    """Reads degree, size, unit, bases, coarsest cell and transform (see `SideInfo`); the inverse of `write_header`.

    Raises:
        UnsupportedVersionError: If a newer release wrote it.
        BitstreamError: If the bytes are damaged or something else.
    """
    reader = ByteReader(data, "side information header")
    version = reader.u8()
    if version not in (RELATIVE, VERSION):
        raise UnsupportedVersionError(
            f"side information has version {version}, this release reads versions {RELATIVE} and {VERSION}"
        )
    degree, size_log, unit = reader.u8(), reader.signed(), reader.signed()
    bases = np.array([reader.signed() for _ in STEPS], dtype=np.int64)
    coarsest = -1 if version == RELATIVE else reader.u8()
    transform = reader.rest()
    if degree > MAX_DEGREE or abs(size_log) > MAX_SIZE_LOG or not 0 <= unit <= MAX_LATTICE_BITS:
        raise BitstreamError(f"side information: degree {degree}, size {size_log} or unit {unit} are impossible")
    if coarsest > MAX_LATTICE_BITS:
        raise BitstreamError(f"side information: cells of places of 2**{coarsest} units are impossible")
    if np.abs(bases).max() > 64 << STEP_BITS:
        raise BitstreamError(f"side information: impossible steps {bases.tolist()}")
    side = (degree + 1) ** 2 - 1
    if len(transform) != side * side:
        raise BitstreamError(f"side information: a transform of {len(transform)} entries, not {side * side}")
    return (
        degree,
        size_log,
        unit,
        bases,
        coarsest,
        np.frombuffer(transform, np.int8).astype(np.int64).reshape(side, side),
    )


def write_blocks(boxes: Boxes, defaults: np.ndarray) -> bytes:
    """Writes the boxes and the means of blocks, see `SideInfo`."""
    writer = ByteWriter()
    for shift, origin, extent in zip(boxes.shifts, boxes.origins, boxes.extents, strict=True):
        writer.u8(int(shift))
        for value in origin.tolist():
            writer.signed(value)
        for value in extent.tolist():
            writer.u8(value)
    for column in defaults.T:
        write_integers(writer, column)
    return writer.bytes()


def read_blocks(data: bytes, num_blocks: int) -> tuple[Boxes, np.ndarray]:
    """Reads boxes and means; the inverse of `write_blocks`.

    Raises:
        BitstreamError: If the bytes are damaged or something else.
    """
    reader = ByteReader(data, "side information blocks")
    if num_blocks * 7 > len(data):
        raise BitstreamError(f"side information: {len(data)} bytes cannot hold {num_blocks} boxes")
    shifts = np.zeros(num_blocks, dtype=np.int64)
    corners = np.zeros((num_blocks, 6), dtype=np.int64)
    for block in range(num_blocks):
        shifts[block] = reader.u8()
        corners[block] = [*(reader.signed() for _ in range(3)), *(reader.u8() for _ in range(3))]
    if shifts.max(initial=0) > MAX_LATTICE_BITS - BOX_BITS or _far(shifts, corners[:, :3]):
        raise BitstreamError("side information: a block's box is impossible")
    defaults = np.stack([read_integers(reader, num_blocks) for _ in range(NUM_DEFAULTS)], axis=1)
    reader.finish()
    return Boxes(shifts, corners[:, :3], corners[:, 3:]), np.clip(defaults, -1 << 9, 1 << 9)


def _far(shifts: np.ndarray, origins: np.ndarray) -> bool:
    return bool((np.abs(origins) > (1 << MAX_LATTICE_BITS) >> shifts[:, None]).any())


def _num_contexts(degree: int) -> int:
    return NUM_CONTEXTS if degree else FIRST_HARMONIC


def _contexts(info: SideInfo) -> bytes:
    """Probabilities of bits as they are; scales as bits "not that of the context before", and the differences."""
    writer, steps = ByteWriter(), np.diff(info.scales, axis=2, prepend=0)
    writer.blob(bytes(info.bit_zero[: _num_contexts(info.degree)].astype(np.uint8)))
    changed = (steps != 0).ravel()
    writer.blob(encode_bits(changed.astype(np.uint8), _change_contexts(), fresh_models(2)))
    write_integers(writer, steps.ravel()[changed])
    return writer.bytes()


def _read_contexts(data: bytes, degree: int) -> tuple[np.ndarray, np.ndarray]:
    reader = ByteReader(data, "side information contexts")
    zero = np.full(NUM_CONTEXTS, 128, dtype=np.int64)
    bits = reader.blob()
    if len(bits) != _num_contexts(degree):
        raise BitstreamError(f"side information: {len(bits)} models of bits, not {_num_contexts(degree)}")
    zero[: len(bits)] = np.frombuffer(bits, dtype=np.uint8)
    changed = decode_bits(reader.blob(), _change_contexts(), fresh_models(2)) != 0
    steps = np.zeros(changed.shape, dtype=np.int64)
    steps[changed] = read_integers(reader, int(changed.sum()))
    reader.finish()
    scales = np.cumsum(steps.reshape(TABLE_SHAPE), axis=2)
    return np.clip(zero, 1, 255), np.clip(scales, 0, NUM_SCALES // SCALE_UNIT - 1)


def _change_contexts() -> np.ndarray:
    first = np.zeros(TABLE_SHAPE, dtype=np.int64)
    first[:, :, 0] = 1
    return first.ravel()
