"""Anchor positions: order, and the lossless coder of the voxel indices."""

import numpy as np

from splatwire.byte_io import ByteReader, ByteWriter
from splatwire.entropy.coder import fresh_models, tables
from splatwire.errors import BitstreamError
from splatwire.ops.morton import MAX_AXIS_BITS, morton_decode, morton_encode

ORIGIN_ALIGNMENT = 1024
"""The origin is a multiple of this, so that anchors on a coarse grid keep their zero low bits."""


def origin_of(voxels: np.ndarray) -> np.ndarray:
    """Lowest corner of the points, rounded down to `ORIGIN_ALIGNMENT`; int64 (3)."""
    if not len(voxels):
        return np.zeros(3, dtype=np.int64)
    return voxels.min(axis=0) // ORIGIN_ALIGNMENT * ORIGIN_ALIGNMENT


def anchor_order(voxels: np.ndarray, order: str) -> np.ndarray:
    """Sorts anchors for packetization.

    Args:
        voxels: int64 (N, 3).
        order: `morton` (Z-order) or `raster` (z, then y, then x: what HAC++ calls Morton order).

    Returns:
        int64 (N): index of the anchor at each rank; equal positions keep their order.
    """
    if order == "raster":
        return np.lexsort((voxels[:, 0], voxels[:, 1], voxels[:, 2]))
    return np.argsort(morton_encode(voxels - origin_of(voxels)), kind="stable")


def encode_positions(voxels: np.ndarray) -> bytes:
    """Codes a set of voxel indices without loss.

    Args:
        voxels: int64 (N, 3) in any order; repeated points are kept.

    Returns:
        Origin, extent and the counts of a binary space partition, at least N bits long.

    Raises:
        ValueError: If the points span 2**21 voxels or more.
    """
    from splatwire.codec import _geometry_kernels as kernels

    origin = origin_of(voxels)
    codes = np.sort(morton_encode(voxels - origin))
    bits = int(codes[-1]).bit_length() if len(codes) else 0
    bits = -(-bits // 3) * 3
    buffer = np.empty(len(codes) * (bits + 8) + 64, dtype=np.uint8)
    length = kernels.encode_codes(codes, bits, fresh_models(kernels.NUM_CONTEXTS), *tables(), buffer)
    # a length of at least one bit per point lets a decoder bound its memory by the bytes it holds
    length = max(length, -(-len(codes) // 8))
    writer = ByteWriter()
    for value in origin:
        writer.signed(int(value))
    writer.u8(bits)
    padded = np.zeros(length, dtype=np.uint8)
    used = min(length, len(buffer))
    padded[:used] = buffer[:used]
    return writer.bytes() + padded.tobytes()


def decode_positions(data: bytes, count: int, order: str) -> np.ndarray:
    """Inverse of `encode_positions`.

    Args:
        data: The code.
        count: Number of points.
        order: Order of the result, as in `anchor_order`.

    Returns:
        int64 (count, 3), sorted by rank.

    Raises:
        BitstreamError: If the bytes cannot hold that many points.
    """
    from splatwire.codec import _geometry_kernels as kernels

    reader = ByteReader(data, "positions")
    origin = np.array([reader.signed() for _ in range(3)], dtype=np.int64)
    bits = reader.u8()
    if bits > 3 * MAX_AXIS_BITS or bits % 3 or np.abs(origin).max() > 1 << 40:
        raise BitstreamError(f"positions: impossible extent of {bits} bits at {origin.tolist()}")
    code = reader.rest()
    if count > 8 * len(code):
        raise BitstreamError(f"positions: {len(code)} bytes cannot hold {count} anchors")
    codes = np.empty(count, dtype=np.int64)
    models = fresh_models(kernels.NUM_CONTEXTS)
    kernels.decode_codes(np.frombuffer(code, dtype=np.uint8), count, bits, models, *tables(), codes)
    voxels = morton_decode(codes) + origin
    return voxels if order == "morton" else voxels[anchor_order(voxels, order)]
