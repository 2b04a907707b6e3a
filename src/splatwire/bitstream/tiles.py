"""Tiles of a scene with levels of detail, read from the side information."""

import itertools
from dataclasses import dataclass

import numpy as np

from splatwire.arguments import CheckedFields
from splatwire.bitstream.limits import MAX_SIZE_LOG
from splatwire.bitstream.manifest import Manifest
from splatwire.bitstream.sections import split_sections
from splatwire.bitstream.tile_index import read_tile_index
from splatwire.errors import BitstreamError
from splatwire.files.byte_io import ByteReader
from splatwire.reprs import summary_repr

MAX_LATTICE_BITS = 40
"""Largest `-log2` of the quantisation step of box corners, as a fraction of the scene size."""


@dataclass(frozen=True, eq=False)
class Tiles(CheckedFields):
    """Tiles of a scene with levels of detail; each tile is one block of the stream, coarsest level first.

    Attributes:
        levels: Level of detail of each tile, 0 for the finest, int64 (B).
        parents: Index of the coarser tile that replaces each tile, int64 (B); -1 for tiles of the coarsest level.
        counts: Number of Gaussians of each tile, int64 (B).
        packets: Number of packets of each tile, int64 (B).
        sizes: Bytes of each tile in the file, int64 (B).
        errors: Geometric error of each tile, world units, float64 (B). A tile replaces certain Gaussians of the finest
            level. The error is the RMS distance between the tile's own Gaussians and the replaced ones.
        low: Lower corner of the bounding box of each tile, world units, float64 (B, 3).
        high: Upper corner of the box, float64 (B, 3).
    """

    levels: np.ndarray
    parents: np.ndarray
    counts: np.ndarray
    packets: np.ndarray
    sizes: np.ndarray
    errors: np.ndarray
    low: np.ndarray
    high: np.ndarray

    __repr__ = summary_repr

    @property
    def num_tiles(self) -> int:
        """Number of tiles, B."""
        return len(self.levels)

    @property
    def first_packets(self) -> np.ndarray:
        """Index of each tile's first packet in sending order, int64 (B + 1).

        The last entry is the total number of packets.
        """
        return np.concatenate([[0], np.cumsum(self.packets)]).astype(np.int64)


def parents_of(children: int, parents: int) -> np.ndarray:
    """Assigns the tiles of a level of detail to the tiles of the next coarser level, in order and evenly.

    Args:
        children: Number of tiles of the finer level.
        parents: Number of tiles of the coarser level.

    Returns:
        For each finer tile, index of the coarser tile that replaces it, int64 (children).
    """
    return ((2 * np.arange(children, dtype=np.int64) + 1) * parents) // (2 * children)


def read_tiles(manifest: Manifest, side_info: bytes) -> Tiles:
    """Reads the tiles of a stream with levels of detail.

    Raises:
        BitstreamError: If the index of tiles is absent, or the side information is damaged.
    """
    index = read_tile_index(manifest, split_sections(side_info, manifest.schema_name)[1])
    plan = manifest.plan
    spans, (low, high) = plan.spans, _boxes(side_info, plan.num_blocks)
    levels = np.repeat(np.arange(len(spans) - 1, -1, -1), [span.num_blocks for span in spans])
    parents = [np.full(spans[0].num_blocks, -1)]
    for coarser, span in itertools.pairwise(spans):
        parents.append(coarser.first_block + parents_of(span.num_blocks, coarser.num_blocks))
    return Tiles(
        levels.astype(np.int64), np.concatenate(parents).astype(np.int64),
        np.array([plan.block_elements(block) for block in range(plan.num_blocks)], dtype=np.int64), index.packets,
        index.sizes, index.errors.astype(np.float64), low, high,
    )  # fmt: skip


def _boxes(side_info: bytes, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns lower and upper corners of the bounding boxes of blocks, world units, float64 (B, 3) each.

    Args:
        side_info: Side information of a stream of Gaussians, serialised.
        count: Number of blocks, B.

    Raises:
        BitstreamError: If the side information is damaged.
    """
    parts = ByteReader(side_info, "side information")
    header, reader = (ByteReader(parts.blob(), "side information") for _ in range(2))
    header.take(2)
    size_log, lattice_bits = header.signed(), header.signed()
    if abs(size_log) > MAX_SIZE_LOG or not 0 <= lattice_bits <= MAX_LATTICE_BITS:
        raise BitstreamError(f"side information: size {size_log} or lattice bits {lattice_bits} are impossible")
    if 7 * count > reader.left:
        raise BitstreamError(f"side information: {reader.left} bytes cannot hold {count} boxes")
    rows = [(reader.u8(), *(reader.signed() for _ in range(3)), *(reader.u8() for _ in range(3))) for _ in range(count)]
    boxes = np.array(rows, dtype=np.float64).reshape(count, 7)
    cells, corners = boxes[:, :1], boxes[:, 1:4]
    if (cells > MAX_LATTICE_BITS).any() or (np.abs(corners) > 2.0 ** (MAX_LATTICE_BITS - cells)).any():
        raise BitstreamError("side information: a block's box is impossible")
    scale = 2.0 ** (cells + size_log - lattice_bits)
    low = corners * scale
    return low, low + (boxes[:, 4:] + 1) * scale
