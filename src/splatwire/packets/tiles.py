"""Which tiles a scene with levels has: blocks of its stream, read from the side information alone."""

import itertools
from dataclasses import dataclass

import numpy as np

from splatwire.byte_io import ByteReader
from splatwire.errors import BitstreamError
from splatwire.packets.limits import MAX_SIZE_LOG
from splatwire.packets.manifest import Manifest
from splatwire.packets.sections import split_sections
from splatwire.packets.tile_index import read_tile_index
from splatwire.reprs import summary_repr

MAX_UNIT = 40
"""Largest `-log2` of the unit of boxes, relative to the scene's size."""


@dataclass(frozen=True, eq=False)
class Tiles:
    """The tiles of a scene, by their block in the stream: those of the coarsest level first.

    Attributes:
        levels: Level of each, 0 for the finest, int64 (B).
        parents: The coarser tile that stands for each, int64 (B); -1 in the coarsest level.
        counts: Gaussians of each, int64 (B).
        packets: Packets of each, int64 (B).
        sizes: Bytes of each in the file, int64 (B).
        errors: How far what it shows is from the finest Gaussians, world units, float64 (B).
        low: Lower corner of the box around its centres, world units, float64 (B, 3).
        high: Upper corner.
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
        """Tiles, B."""
        return len(self.levels)

    @property
    def first_packets(self) -> np.ndarray:
        """Where the packets of each begin in the sending order, and where the last one's end, int64 (B + 1)."""
        return np.concatenate([[0], np.cumsum(self.packets)]).astype(np.int64)


def parents_of(children: int, parents: int) -> np.ndarray:
    """The coarser tile that stands for each of some finer ones, int64 (children): about equally many for each."""
    return ((2 * np.arange(children, dtype=np.int64) + 1) * parents) // (2 * children)


def read_tiles(manifest: Manifest, side_info: bytes) -> Tiles:
    """The tiles of a stream with levels.

    Raises:
        BitstreamError: If it has no index of tiles, or its side information is damaged.
    """
    index = read_tile_index(manifest, split_sections(side_info, manifest.codec)[1])
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
    """Corners of the boxes of blocks, world units, float64 (B, 3) each (docs/format.md)."""
    parts = ByteReader(side_info, "side information")
    header, reader = (ByteReader(parts.blob(), "side information") for _ in range(2))
    header.take(2)
    size_log, unit = header.signed(), header.signed()
    if abs(size_log) > MAX_SIZE_LOG or not 0 <= unit <= MAX_UNIT:
        raise BitstreamError(f"side information: size {size_log} or unit {unit} are impossible")
    if 7 * count > reader.left:
        raise BitstreamError(f"side information: {reader.left} bytes cannot hold {count} boxes")
    rows = [(reader.u8(), *(reader.signed() for _ in range(3)), *(reader.u8() for _ in range(3))) for _ in range(count)]
    boxes = np.array(rows, dtype=np.float64).reshape(count, 7)
    cells, corners = boxes[:, :1], boxes[:, 1:4]
    if (cells > MAX_UNIT).any() or (np.abs(corners) > 2.0 ** (MAX_UNIT - cells)).any():
        raise BitstreamError("side information: a block's box is impossible")
    scale = 2.0 ** (cells + size_log - unit)
    low = corners * scale
    return low, low + (boxes[:, 4:] + 1) * scale
