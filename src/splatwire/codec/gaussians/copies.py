"""Redundant copies of important Gaussians in the side information, which receivers draw where packets were lost."""

from dataclasses import replace

import numpy as np

from splatwire.bitstream.limits import MAX_COPIES
from splatwire.codec.gaussians import _packet_kernels as kernels
from splatwire.codec.gaussians.attributes import empty_rows, to_splats
from splatwire.codec.gaussians.blocks import Boxes
from splatwire.codec.gaussians.layout import CLASS
from splatwire.codec.gaussians.side_info import SideInfo, read_blocks
from splatwire.errors import BitstreamError, UnsupportedVersionError
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.types import Copies

SECTION = "sketch"
VERSION = 1
GROWTH_UNIT = 64
"""Denominator of the growth parameters of copies (see `Copies`) in the bitstream."""


def write_indices(indices: np.ndarray, num_gaussians: int) -> bytes:
    """Serialises the indices of the copied Gaussians as fixed-width integers.

    Args:
        indices: For each copy, index of its original in the stream's scene, int64.
        num_gaussians: Number of Gaussians in the stream, which determines the number of bits of an index.
    """
    width = _index_bits(num_gaussians)
    return np.packbits(indices[:, None] >> np.arange(width)[::-1] & 1).tobytes()


def _read_indices(reader: ByteReader, count: int, num_gaussians: int) -> np.ndarray:
    width = _index_bits(num_gaussians)
    bits = np.unpackbits(np.frombuffer(reader.take((count * width + 7) // 8), np.uint8), count=count * width)
    indices = bits.reshape(count, width).astype(np.int64) @ (1 << np.arange(width)[::-1])
    if indices.max() >= num_gaussians or len(np.unique(indices)) < count:
        raise BitstreamError("section 'sketch': an index of a copy is repeated or out of range")
    return indices


def _index_bits(num_gaussians: int) -> int:
    return max((num_gaussians - 1).bit_length(), 1)


def write_copies_header(growth: tuple[float, float, float], count: int, blocks: bytes) -> bytes:
    """Serialises the header of the section with redundant copies of Gaussians.

    Args:
        growth: Parameters for enlarging received Gaussians next to lost ones, see `Copies.growth`.
        count: Number of copies.
        blocks: Bounding box and mean attributes of the copies, serialised.
    """
    writer = ByteWriter()
    writer.u8(VERSION)
    for value in growth:
        writer.u8(min(max(round(value * GROWTH_UNIT), 0), 255))
    writer.unsigned(count)
    writer.blob(blocks)
    return writer.bytes()


def read_copies(info: SideInfo, num_gaussians: int) -> Copies | None:
    """Reads the redundant copies of Gaussians from a stream's side information.

    Args:
        info: The stream's side information.
        num_gaussians: Number of Gaussians in the stream.

    Returns:
        The copies; None if the stream has none.

    Raises:
        UnsupportedVersionError: If a newer release wrote the section of copies.
        BitstreamError: If the section is damaged or belongs to another stream.
    """
    if SECTION not in info.sections:
        return None
    boxes, indices, growth, (rows, harmonics) = _parse_section(info, num_gaussians)
    corners = np.broadcast_to(boxes.corners[0], (len(indices), 3))
    splats = to_splats(rows, harmonics, corners, info.lattice_bits, info.size_log, info.transform)
    return Copies(indices, splats, growth)


def copies_precision_class(info: SideInfo, num_gaussians: int) -> int:
    """Returns the precision class (set of quantisation steps) of a stream's redundant copies of Gaussians.

    Args:
        info: The stream's side information.
        num_gaussians: Number of Gaussians in the stream.

    Raises:
        UnsupportedVersionError: If a newer release wrote the section of copies.
        BitstreamError: If the section is damaged or belongs to another stream.
    """
    rows, _ = _parse_section(info, num_gaussians)[3]
    return int(rows[0, CLASS])


def _parse_section(
    info: SideInfo, num_gaussians: int
) -> tuple[Boxes, np.ndarray, tuple[float, float, float], tuple[np.ndarray, np.ndarray]]:
    """Parses the section with redundant copies of Gaussians, without dequantisation.

    Args:
        info: The stream's side information, which contains the section.
        num_gaussians: Number of Gaussians in the stream.

    Returns:
        Four items: bounding box of the copies; indices of the copied Gaussians; parameters for enlarging received
        Gaussians (`Copies.growth`); and decoded integers of the copies.

    Raises:
        UnsupportedVersionError: If a newer release wrote the section.
        BitstreamError: If the section is damaged or belongs to another stream.
    """
    reader = ByteReader(info.sections[SECTION], f"section '{SECTION}'")
    version = reader.u8()
    if version != VERSION:
        raise UnsupportedVersionError(f"section '{SECTION}' has version {version}, this release reads {VERSION}")
    size, opacity, trust = (reader.u8() / GROWTH_UNIT for _ in range(3))
    count = reader.unsigned()
    if not 1 <= count <= min(num_gaussians, MAX_COPIES):
        raise BitstreamError(f"section '{SECTION}': {count} copies of {num_gaussians} Gaussians are impossible")
    boxes, block_means = read_blocks(reader.blob(), 1)
    indices = _read_indices(reader, count, num_gaussians)
    copies_info = replace(info, boxes=boxes, block_means=block_means)
    return boxes, indices, (size, opacity, trust), _decode(copies_info, count, reader.rest())


def remap_copies(section: bytes, new_index: np.ndarray) -> bytes:
    """Updates the indices in the section of redundant copies after the Gaussians of the stream were reordered.

    Each copy refers to its original Gaussian by index.

    Args:
        section: Content of the section `sketch` before the reordering: the copies in encoded form.
        new_index: Entry i is the new index of the Gaussian whose old index is i, int64 (N).

    Returns:
        Content of the section with the new indices.
    """
    reader = ByteReader(section, f"section '{SECTION}'")
    head, count, blocks = reader.take(4), reader.unsigned(), reader.blob()
    indices, writer = _read_indices(reader, count, len(new_index)), ByteWriter()
    writer.unsigned(count)
    writer.blob(blocks)
    return bytes(head) + writer.bytes() + write_indices(new_index[indices], len(new_index)) + bytes(reader.rest())


def _decode(info: SideInfo, count: int, payload: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Decodes the redundant copies of Gaussians to integers.

    Args:
        info: The stream's side information.
        count: Number of copies.
        payload: The copies, entropy-coded.

    Returns:
        Two arrays with one row per copy: all integers except spherical harmonics, and the spherical harmonics.
    """
    rows, harmonics = empty_rows(count, info.num_harmonic_columns)
    data, byte_starts = np.frombuffer(payload, dtype=np.uint8).copy(), np.array([0, len(payload)], dtype=np.int64)
    kernels.decode_packets(
        info.kernel_tables, info.step_parameters(), info.models(), data, byte_starts,
        np.array([0, count], dtype=np.int64), info.boxes.bits, info.block_means, rows, harmonics,
    )  # fmt: skip
    return rows, harmonics
