"""Positions of anchors: coding order, and lossless coding as voxel indices."""

import numpy as np

from splatwire.codec import _geometry_kernels as kernels
from splatwire.entropy.coder import fresh_models, tables
from splatwire.errors import BitstreamError
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.ops.morton import MAX_AXIS_BITS, morton_decode, morton_encode

CORNER_ALIGNMENT = 1024
"""Alignment of the corner in voxels, a power of two. It preserves low bits that are 0 for anchors on a coarse grid."""


def corner_of(voxels: np.ndarray) -> np.ndarray:
    """Returns the lower corner of the voxels' bounding box, rounded down to `CORNER_ALIGNMENT` voxels, int64 (3)."""
    if not len(voxels):
        return np.zeros(3, dtype=np.int64)
    return voxels.min(axis=0) // CORNER_ALIGNMENT * CORNER_ALIGNMENT


def anchor_order(voxels: np.ndarray, order: str) -> np.ndarray:
    """Sorts anchors for the division into packets.

    Args:
        voxels: Voxel indices of the anchors, int64 (N, 3).
        order: `morton` (Z-order) or `raster` (by z, then y, then x).

    Returns:
        Permutation, int64 (N): entry i is the index in `voxels` of the i-th anchor in sorted order. Anchors at equal
        positions keep their order.
    """
    # HAC++ calls the raster order Morton order.
    if order == "raster":
        return np.lexsort((voxels[:, 0], voxels[:, 1], voxels[:, 2]))
    return np.argsort(morton_encode(voxels - corner_of(voxels)), kind="stable")


def encode_positions(voxels: np.ndarray) -> bytes:
    """Encodes a set of voxels without loss.

    Args:
        voxels: Integer coordinates (x, y, z) of voxels in any order, int64 (N, 3). Repeated voxels are kept.

    Returns:
        The encoded bytes.

    Raises:
        ValueError: If the points span more than 2**21 voxels along an axis (measured from `corner_of`).
    """
    corner = corner_of(voxels)
    codes = np.sort(morton_encode(voxels - corner))
    bits = int(codes[-1]).bit_length() if len(codes) else 0
    bits = -(-bits // 3) * 3
    buffer = np.empty(len(codes) * (bits + 8) + 64, dtype=np.uint8)
    length = kernels.encode_codes(codes, bits, fresh_models(kernels.NUM_CONTEXTS), *tables(), buffer)
    # at least one bit per point, so that decoders can bound their memory by the number of bytes
    length = max(length, -(-len(codes) // 8))
    writer = ByteWriter()
    for value in corner:
        writer.signed(int(value))
    writer.u8(bits)
    padded = np.zeros(length, dtype=np.uint8)
    used = min(length, len(buffer))
    padded[:used] = buffer[:used]
    return writer.bytes() + padded.tobytes()


def decode_positions(data: bytes, count: int, order: str) -> np.ndarray:
    """Decodes the voxels written by `encode_positions`.

    Args:
        data: Bytes written by `encode_positions`.
        count: Number of voxels. A voxel that was encoded k times counts k times.
        order: Order of the voxels in the result: `morton` (Z-order) or `raster` (by z, then y, then x).

    Returns:
        Integer coordinates (x, y, z) of each voxel, int64 (count, 3).

    Raises:
        BitstreamError: If `data` is too short for this number of voxels, or the coordinates in it are out of range.
    """
    reader = ByteReader(data, "positions")
    corner = np.array([reader.signed() for _ in range(3)], dtype=np.int64)
    bits = reader.u8()
    if bits > 3 * MAX_AXIS_BITS or bits % 3 or np.abs(corner).max() > 1 << 40:
        raise BitstreamError(f"positions: impossible extent of {bits} bits at {corner.tolist()}")
    code = reader.rest()
    if count > 8 * len(code):
        raise BitstreamError(f"positions: {len(code)} bytes cannot hold {count} anchors")
    codes = np.empty(count, dtype=np.int64)
    models = fresh_models(kernels.NUM_CONTEXTS)
    kernels.decode_codes(np.frombuffer(code, dtype=np.uint8), count, bits, models, *tables(), codes)
    voxels = morton_decode(codes) + corner
    return voxels if order == "morton" else voxels[anchor_order(voxels, order)]
