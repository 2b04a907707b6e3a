"""Where anchors are: down to small nodes of a tree in the side information, the rest in packets (docs/format.md)."""

from dataclasses import dataclass

import numpy as np

from splatwire.byte_io import ByteReader, ByteWriter
from splatwire.codec.geometry import origin_of
from splatwire.entropy.coder import fresh_models
from splatwire.errors import BitstreamError
from splatwire.ops.morton import MAX_AXIS_BITS, morton_decode, morton_encode
from splatwire.packets.limits import MAX_LEAF, MAX_PLACE, MAX_POSITION_BITS

CHANCES = 256


@dataclass(frozen=True, eq=False)
class Places:
    """Where N anchors are, by rank, as far as it is known.

    Attributes:
        origin: int64 (3), voxel that the codes count from.
        codes: int64 (N), ascending Morton codes; what is not known of them is guessed.
        unknown: int64 (N), how many low bits of each code are not known.
    """

    origin: np.ndarray
    codes: np.ndarray
    unknown: np.ndarray

    @property
    def voxels(self) -> np.ndarray:
        """Voxel indices, int64 (N, 3)."""
        return morton_decode(self.codes) + self.origin

    def select(self, ranks: np.ndarray) -> "Places":
        """Those of some of the anchors, int64 (n)."""
        return Places(self.origin, self.codes[ranks], self.unknown[ranks])


@dataclass(frozen=True, eq=False)
class SharedPlaces:
    """What all packets share of the places.

    Attributes:
        section: The section of the side information that says so.
        known: Where each anchor is, as far as it is known without its packet.
        chances: int64 (rows + 1, rows + 1): entry (T, t) is how probable it is, out of `CHANCES`, that of T triples of
            bits that are not known the lowest that is not 0 is number t, if it is not one below.
    """

    section: bytes
    known: Places
    chances: np.ndarray


def share_places(voxels: np.ndarray, leaf: int) -> SharedPlaces:
    """Decides what all packets share of the places of anchors.

    Args:
        voxels: int64 (N, 3).
        leaf: Anchors of a node that is not split any further, 1 to 64.

    Raises:
        ValueError: If the points span 2**21 voxels or more.
    """
    origin = origin_of(voxels)
    codes = np.sort(morton_encode(voxels - origin))
    tree = _encode_tree(codes, origin, leaf)
    known = _decode_tree(tree, len(voxels), leaf)
    triples, lowest = triple_levels(codes, known.unknown)
    rows, writer = int(triples.max(initial=0)), ByteWriter()
    writer.u8(leaf)
    writer.u8(rows)
    for row in range(1, rows + 1):
        counts = np.bincount(lowest[triples == row], minlength=row + 1)
        left = counts[::-1].cumsum()[::-1]
        for stops, reached in zip(counts[:row].tolist(), left.tolist(), strict=False):
            writer.u8(min(max(round(CHANCES * (stops + 0.5) / (reached + 1)), 1), CHANCES - 1))
    return read_places(writer.bytes() + tree, len(voxels))


def _encode_tree(codes: np.ndarray, origin: np.ndarray, leaf: int) -> bytes:
    from splatwire.codec.schemas.causal import _place_kernels as kernels

    bits = -(-(int(codes[-1]).bit_length() if len(codes) else 0) // 3) * 3
    buffer = np.zeros(4 * len(codes) + 16 * MAX_AXIS_BITS, dtype=np.uint8)
    length = kernels.encode_tree(codes, bits, leaf, fresh_models(kernels.NUM_CONTEXTS), buffer)
    writer = ByteWriter()
    for value in origin:
        writer.signed(int(value))
    writer.u8(bits)
    # a length of at least one bit for each anchor lets a decoder bound its memory by the bytes it holds
    return writer.bytes() + buffer[: max(length, -(-len(codes) // 8))].tobytes()


def _decode_tree(data: bytes, count: int, leaf: int) -> Places:
    from splatwire.codec.schemas.causal import _place_kernels as kernels

    reader = ByteReader(data, "positions")
    origin = np.array([reader.signed() for _ in range(3)], dtype=np.int64)
    bits = reader.u8()
    if bits > MAX_POSITION_BITS or bits % 3 or np.abs(origin).max() > MAX_PLACE:
        raise BitstreamError(f"positions: impossible extent of {bits} bits at {origin.tolist()}")
    code = reader.rest()
    if count > 8 * len(code):
        raise BitstreamError(f"positions: {len(code)} bytes cannot hold {count} anchors")
    codes, unknown = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    models = fresh_models(kernels.NUM_CONTEXTS)
    kernels.decode_tree(np.frombuffer(code, dtype=np.uint8), bits, leaf, models, codes, unknown)
    return Places(origin, codes, unknown)


def triple_levels(codes: np.ndarray, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How many triples of bits are not known of each code, and which is the lowest of them that is not 0.

    Args:
        codes: int64 (N), the exact codes.
        unknown: int64 (N), how many low bits are not known of each.

    Returns:
        Two int64 (N); where all triples are 0, the second is the first.
    """
    triples, rest = (unknown + 2) // 3, codes & ((np.int64(1) << unknown) - 1)
    lowest = np.zeros(len(codes), dtype=np.int64)
    for level in range(int(triples.max(initial=0))):
        lowest += (rest & ((1 << (3 * level + 3)) - 1) == 0) & (level < triples)
    return triples, lowest


def read_places(section: bytes, num_anchors: int) -> SharedPlaces:
    """Reads the section of the side information.

    Args:
        section: Its bytes.
        num_anchors: Anchors of the scene.

    Raises:
        BitstreamError: If the bytes are damaged or something else.
    """
    reader = ByteReader(section, "positions")
    leaf, rows = reader.u8(), reader.u8()
    if not 0 < leaf <= MAX_LEAF or rows > MAX_AXIS_BITS:
        raise BitstreamError(f"positions: nodes of {leaf} anchors, {rows} rows of chances")
    chances = np.zeros((rows + 1, rows + 1), dtype=np.int64)
    for row in range(1, rows + 1):
        chances[row, :row] = np.frombuffer(reader.take(row), dtype=np.uint8)
    known = _decode_tree(reader.rest(), num_anchors, leaf)
    missing = int((known.unknown.max(initial=0) + 2) // 3)
    if missing > rows or not chances[np.tril_indices(rows + 1, -1)].all():
        raise BitstreamError(f"positions: no chances for {missing} triples of bits among {rows} rows")
    return SharedPlaces(section, known, chances)
