"""Index of a stream's tiles (spatial blocks of one level of detail), for fetching single tiles of a file over HTTP."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from splatwire.bitstream.limits import MAX_PACKET_BYTES
from splatwire.bitstream.manifest import Manifest
from splatwire.bitstream.scene_stream import RECORD_PREFIX, SceneStream
from splatwire.bitstream.sections import with_section
from splatwire.errors import BitstreamError
from splatwire.files.byte_io import ByteReader, ByteWriter
from splatwire.reprs import summary_repr

SECTION = "tiles"
"""Name of the section."""


@dataclass(frozen=True, eq=False)
class TileIndex:
    """Index of a stream's tiles in the order of its blocks. A tile is a spatial block of one level of detail.

    Attributes:
        packets: Number of packets of each tile, int64 (B).
        sizes: Size of each tile in the file, bytes, int64 (B).
        errors: Geometric error of each tile, world units, float32 (B). A tile replaces certain Gaussians of the finest
            level. The error is the RMS distance between the tile's own Gaussians and the replaced ones.
    """

    packets: np.ndarray
    sizes: np.ndarray
    errors: np.ndarray

    __repr__ = summary_repr

    @property
    def offsets(self) -> np.ndarray:
        """Position of each of the B tiles in the stream file, counted from the end of the side information.

        The last entry is the end of the last tile. The dtype is int64, the shape (B + 1).
        """
        return np.concatenate([[0], np.cumsum(self.sizes)]).astype(np.int64)


def with_tile_index(stream: SceneStream, errors: np.ndarray) -> SceneStream:
    """Adds the index of tiles to the side information of a complete stream.

    Args:
        stream: The stream, with all packets.
        errors: Geometric error of each tile (see `TileIndex`), world units, float32 (B).
    """
    blocks = np.array([packet.id.block for packet in stream.packets], dtype=np.int64)
    weights = np.array([packet.num_bytes + RECORD_PREFIX.size for packet in stream.packets], dtype=np.float64)
    writer = ByteWriter()
    num_blocks = stream.manifest.plan.num_blocks
    for values in (np.bincount(blocks, minlength=num_blocks), np.bincount(blocks, weights, num_blocks)):
        for value in values.astype(np.int64).tolist():
            writer.unsigned(value)
    for error in errors[: _num_coarser_tiles(stream.manifest)].tolist():
        writer.f32(error)
    return with_section(stream, SECTION, writer.bytes())


def read_tile_index(manifest: Manifest, sections: Mapping[str, bytes]) -> TileIndex:
    """Reads the index of a stream's tiles (spatial blocks of one level of detail).

    Args:
        manifest: The stream's manifest.
        sections: Named sections of its side information.

    Raises:
        BitstreamError: If the index is absent or inconsistent.
    """
    if not manifest.schema.tiled or SECTION not in sections:
        raise BitstreamError("the stream has no index of tiles")
    reader = ByteReader(sections[SECTION], "index of tiles")
    num_blocks, coarser = manifest.plan.num_blocks, _num_coarser_tiles(manifest)
    if reader.left < 2 * num_blocks + 4 * coarser:
        raise BitstreamError(f"index of tiles: {reader.left} bytes are too few for {num_blocks} tiles")
    packets, sizes = ([reader.unsigned() for _ in range(num_blocks)] for _ in range(2))
    errors = [reader.f32() for _ in range(coarser)]
    reader.finish()
    if sum(packets) != manifest.num_packets:
        raise BitstreamError(f"index of tiles: {sum(packets)} packets, and the manifest has {manifest.num_packets}")
    if max(sizes, default=0) > MAX_PACKET_BYTES:
        raise BitstreamError(f"index of tiles: a tile of {max(sizes)} bytes is too large")
    if not all(0 <= error < math.inf for error in errors):
        raise BitstreamError("index of tiles: an error is negative or not finite")
    all_errors = np.zeros(num_blocks, dtype=np.float32)
    all_errors[:coarser] = errors
    return TileIndex(np.array(packets, dtype=np.int64), np.array(sizes, dtype=np.int64), all_errors)


def _num_coarser_tiles(manifest: Manifest) -> int:
    """Returns the number of tiles in all levels of detail except the finest one."""
    return manifest.plan.spans[-1].first_block
