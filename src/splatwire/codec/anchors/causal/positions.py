"""Positions of anchors: a coarse tree in the side information, the remaining bits in packets (docs/format.md)."""

from dataclasses import dataclass

import numpy as np

from splatwire.bitstream.limits import MAX_COORD, MAX_LEAF, MAX_POSITION_BITS
from splatwire.codec.anchors.causal import _position_kernels as kernels
from splatwire.codec.geometry import corner_of
from splatwire.entropy.coder import fresh_models
from splatwire.errors import BitstreamError
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.ops.morton import MAX_AXIS_BITS, morton_decode, morton_encode

PROBABILITY_ONE = 256
"""Denominator of the probabilities in the side information."""


@dataclass(frozen=True, eq=False)
class AnchorPositions:
    """Positions of N anchors.

    Attributes:
        corner: Voxel that the Morton codes are relative to, int64 (3).
        codes: Morton codes, int64 (N); low bits may be estimated.
        num_low_bits: Number of low bits of each code that only packets contain, int64 (N).
    """

    corner: np.ndarray
    codes: np.ndarray
    num_low_bits: np.ndarray

    @property
    def voxels(self) -> np.ndarray:
        """Positions of the anchors, in units of voxels, int64 (N, 3)."""
        return morton_decode(self.codes) + self.corner

    def select(self, ranks: np.ndarray) -> "AnchorPositions":
        """Returns the positions of the anchors with the given indices, int64 (n)."""
        return AnchorPositions(self.corner, self.codes[ranks], self.num_low_bits[ranks])


@dataclass(frozen=True, eq=False)
class CoarsePositions:
    """High bits of the positions of all anchors.

    The high bits are part of the side information. The packets contain the low bits.

    Attributes:
        section: Section of the side information with the high bits, serialised.
        known: Positions of all anchors in coding order, as known from the side information: low bits are estimated, and
            codes are ascending.
        low_bit_probabilities: Probabilities for coding the low bits, int64 (T + 1, T + 1), in units of 1/256. The low
            bits of a Morton code are divided into at most T triples of one bit per axis; triple 0 has the lowest bits.
            Row u applies to codes with u triples in their packets. Entry (u, t) is the probability that triple t is not
            0, given that all lower triples are 0.
    """

    section: bytes
    known: AnchorPositions
    low_bit_probabilities: np.ndarray


def encode_coarse_positions(voxels: np.ndarray, max_leaf: int) -> CoarsePositions:
    """Encodes the high bits of all anchors' positions as a section of the side information.

    The low bits are in the packets.

    Args:
        voxels: Positions of the anchors, voxels, int64 (N, 3).
        max_leaf: Maximum number of anchors in a leaf of the tree that codes the high bits, 1 to 64.

    Raises:
        ValueError: If the points span more than 2**21 voxels along an axis (measured from `corner_of`).
    """
    # With larger leaves, more bits are in packets.
    corner = corner_of(voxels)
    codes = np.sort(morton_encode(voxels - corner))
    tree = _encode_tree(codes, corner, max_leaf)
    known = _decode_tree(tree, len(voxels), max_leaf)
    num_triples, lowest = lowest_triples(codes, known.num_low_bits)
    num_rows, writer = int(num_triples.max(initial=0)), ByteWriter()
    writer.u8(max_leaf)
    writer.u8(num_rows)
    for row in range(1, num_rows + 1):
        counts = np.bincount(lowest[num_triples == row], minlength=row + 1)
        num_reached = counts[::-1].cumsum()[::-1]
        for stops, reached in zip(counts[:row].tolist(), num_reached.tolist(), strict=False):
            writer.u8(min(max(round(PROBABILITY_ONE * (stops + 0.5) / (reached + 1)), 1), PROBABILITY_ONE - 1))
    return read_coarse_positions(writer.bytes() + tree, len(voxels))


def _encode_tree(codes: np.ndarray, corner: np.ndarray, max_leaf: int) -> bytes:
    bits = -(-(int(codes[-1]).bit_length() if len(codes) else 0) // 3) * 3
    buffer = np.zeros(4 * len(codes) + 16 * MAX_AXIS_BITS, dtype=np.uint8)
    length = kernels.encode_tree(codes, bits, max_leaf, fresh_models(kernels.NUM_CONTEXTS), buffer)
    writer = ByteWriter()
    for value in corner:
        writer.signed(int(value))
    writer.u8(bits)
    # at least one bit per anchor, so that decoders can bound their memory by the number of bytes
    return writer.bytes() + buffer[: max(length, -(-len(codes) // 8))].tobytes()


def _decode_tree(data: bytes, count: int, max_leaf: int) -> AnchorPositions:
    reader = ByteReader(data, "positions")
    corner = np.array([reader.signed() for _ in range(3)], dtype=np.int64)
    bits = reader.u8()
    if bits > MAX_POSITION_BITS or bits % 3 or np.abs(corner).max() > MAX_COORD:
        raise BitstreamError(f"positions: impossible extent of {bits} bits at {corner.tolist()}")
    code = reader.rest()
    if count > 8 * len(code):
        raise BitstreamError(f"positions: {len(code)} bytes cannot hold {count} anchors")
    codes, num_low_bits = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    models = fresh_models(kernels.NUM_CONTEXTS)
    kernels.decode_tree(np.frombuffer(code, dtype=np.uint8), bits, max_leaf, models, codes, num_low_bits)
    return AnchorPositions(corner, codes, num_low_bits)


def lowest_triples(codes: np.ndarray, num_low_bits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the number of bit triples in each Morton code, and the index of the lowest triple that is not 0.

    A triple has one bit per axis. Packets contain the low bits of a code; only these are divided into triples.

    Args:
        codes: Complete Morton codes of the anchors, int64 (N).
        num_low_bits: Number of low bits of each code that packets contain, int64 (N).

    Returns:
        Number of triples, int64 (N); and index of the lowest triple that is not 0, int64 (N). Index 0 is the triple
        with the lowest bits. If all triples of a code are 0, the index is the number of triples.
    """
    # If all triples are 0, the index equals their number. Low triples are often zero, because anchors lie on grids of
    # several widths.
    num_triples, low_bits = (num_low_bits + 2) // 3, codes & ((np.int64(1) << num_low_bits) - 1)
    lowest = np.zeros(len(codes), dtype=np.int64)
    for triple in range(int(num_triples.max(initial=0))):
        lowest += (low_bits & ((1 << (3 * triple + 3)) - 1) == 0) & (triple < num_triples)
    return num_triples, lowest


def read_coarse_positions(section: bytes, num_anchors: int) -> CoarsePositions:
    """Reads the position section of the side information.

    Args:
        section: Bytes of the position section.
        num_anchors: Anchors of the scene.

    Raises:
        BitstreamError: If the bytes are damaged or not such a section.
    """
    reader = ByteReader(section, "positions")
    max_leaf, rows = reader.u8(), reader.u8()
    if not 0 < max_leaf <= MAX_LEAF or rows > MAX_AXIS_BITS:
        raise BitstreamError(f"positions: nodes of {max_leaf} anchors, {rows} rows of probabilities")
    low_bit_probabilities = np.zeros((rows + 1, rows + 1), dtype=np.int64)
    for row in range(1, rows + 1):
        low_bit_probabilities[row, :row] = np.frombuffer(reader.take(row), dtype=np.uint8)
    known = _decode_tree(reader.rest(), num_anchors, max_leaf)
    missing = int((known.num_low_bits.max(initial=0) + 2) // 3)
    if missing > rows or not low_bit_probabilities[np.tril_indices(rows + 1, -1)].all():
        raise BitstreamError(f"positions: no probabilities for {missing} triples of bits among {rows} rows")
    return CoarsePositions(section, known, low_bit_probabilities)
