"""Divides Gaussians into spatial blocks with bounding boxes, and orders the Gaussians for coding.

Positions are integer coordinates on a lattice: a cubic grid with a spacing of `2 ** -lattice_bits` times the scene
size.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from splatwire.bitstream import PacketPlan
from splatwire.codec.gaussians import _source_kernels as kernels
from splatwire.codec.gaussians.layout import MAX_CELL_BITS, MAX_LATTICE_BITS
from splatwire.errors import InvalidValueError
from splatwire.files.mmap_array import large_empty
from splatwire.ops.code_order import code_order
from splatwire.ops.morton import MAX_AXIS_BITS
from splatwire.ops.order_statistics import quantiles
from splatwire.ops.threads import parallel_map

CACHE_GAUSSIANS = 1 << 13
"""Maximum number of Gaussians converted at a time, whose intermediate results fit into the processor's caches."""
TYPICAL_BLOCK_GAUSSIANS = 3000
"""Number of Gaussians of a typical block."""
TYPICAL_BLOCK_SAMPLE = 1 << 14
"""Maximum number of Gaussians sampled to estimate the extent of such a block."""
BOX_BITS = 8
"""Maximum number of bits of a bounding box's side, which is in spacings of the box's grid (see `Boxes`)."""


@dataclass(frozen=True, eq=False)
class Boxes:
    """Bounding boxes of B blocks of Gaussians. The corners of each box lie on a grid with a power-of-two spacing.

    Attributes:
        shifts: int64 (B), log2 of the spacing of each box's grid, in spacings of the position lattice.
        grid_corners: int64 (B, 3), lower corner of each box, in spacings of its grid.
        extents: int64 (B, 3), sides of each box in spacings of its grid, minus one.
    """

    shifts: np.ndarray
    grid_corners: np.ndarray
    extents: np.ndarray

    @functools.cached_property
    def bits(self) -> np.ndarray:
        """Number of bits per axis of a position within each box, int64 (B)."""
        return self.shifts + np.array(
            [int(e).bit_length() for e in self.extents.max(axis=1, initial=0)], dtype=np.int64
        )

    @functools.cached_property
    def corners(self) -> np.ndarray:
        """Lower corners of the boxes, in spacings of the position lattice, int64 (B, 3)."""
        return self.grid_corners << self.shifts[:, None]


def chunks(values: np.ndarray) -> Iterator[np.ndarray]:
    """Yields consecutive slices of an array along the first axis, of at most `CACHE_GAUSSIANS` entries each."""
    for begin in range(0, len(values), CACHE_GAUSSIANS):
        yield values[begin : begin + CACHE_GAUSSIANS]


def float64_chunks(values: np.ndarray) -> Iterator[np.ndarray]:
    """Yields the slices of an array from `chunks`, converted to float64."""
    return (piece.astype(np.float64) for piece in chunks(values))


def gaussian_order(means: np.ndarray, tiers: np.ndarray | None) -> np.ndarray:
    """Sorts Gaussians by importance and, if equally important, along a Morton curve.

    Args:
        means: (N, 3), positions.
        tiers: Importance tier of each Gaussian. Tier 0 is the most important, and is sorted first. None if all
            Gaussians are equally important.

    Returns:
        Entry i is the index in `means` of the i-th Gaussian in sorted order, uint32 (N).
    """
    ends = (0.01, 0.99)
    quantile_pairs = parallel_map(
        lambda column: quantiles(functools.partial(chunks, column), len(means), ends), list(means.T)
    )
    low, high = np.stack(quantile_pairs, axis=1)
    middle, extent = (low + high) / 2, max(float((high - low).max()), 1e-30)

    def compressed(positions: np.ndarray) -> np.ndarray:
        """Compresses positions far from the centre (asinh), so that outliers do not make the Morton codes coarse."""
        # Otherwise, distant Gaussians would make the Morton codes of all others coarse.
        warped = positions - middle
        warped /= extent / 2
        return np.arcsinh(warped, out=warped)

    first, last = compressed(np.array([means.min(axis=0), means.max(axis=0)], dtype=np.float64))
    size = max(float((last - first).max()), 1e-30)

    codes = large_empty((len(means),), np.int64)

    def encode_slice(begin: int) -> None:
        warped = compressed(means[begin : begin + CACHE_GAUSSIANS].astype(np.float64))
        warped -= first
        warped /= size
        warped *= (1 << MAX_AXIS_BITS) - 1
        used_bits = kernels.write_codes(
            np.rint(warped, out=warped).astype(np.int64), 0, codes[begin : begin + CACHE_GAUSSIANS]
        )
        if used_bits >> MAX_AXIS_BITS:  # not 0 for negative numbers either
            raise ValueError("positions must be finite to have a code")

    parallel_map(encode_slice, range(0, len(means), CACHE_GAUSSIANS))
    return code_order(codes, 3 * MAX_AXIS_BITS, tiers)


def block_sizes(plan: PacketPlan) -> np.ndarray:
    """Returns the number of Gaussians in each of the B spatial blocks of a packet plan, int64 (B)."""
    return np.array([plan.block_elements(block) for block in range(plan.num_blocks)], dtype=np.int64)


def choose_cell_shift(positions: np.ndarray, bits: int) -> int:
    """Chooses the grid for coding a block's positions, and returns log2 of its cell size.

    A position is coded as a grid cell, followed by raw bits within the cell.

    Args:
        positions: int64 (n, 3), positions relative to the corner of the block's box, in lattice spacings.
        bits: Number of bits of a coordinate within the box.

    Returns:
        log2 of the cell size, in lattice spacings.
    """
    # About `16 * sqrt(n)` cells per side, which suits n Gaussians on a surface.
    depth = 4 + (len(positions).bit_length() + 1) // 2
    extent_bits = int(kernels.extents(positions, np.array([0, len(positions)]))[0]).bit_length()
    return max(extent_bits - depth, bits - MAX_CELL_BITS, 0)


def make_boxes(low: np.ndarray, high: np.ndarray, max_position_shift: int = 0) -> Boxes:
    """Computes the bounding box of each block of Gaussians, with corners on a coarse grid.

    Args:
        low: int64 (B, 3), smallest coordinates of each block, in spacings of the position lattice.
        high: int64 (B, 3), largest coordinates of each block, in the same unit.
        max_position_shift: log2 of the largest quantisation step of positions, in the same unit. Box corners are
            multiples of this step.
    """
    # Corners are multiples of the largest quantisation step, so that steps have the same edges in every box.
    shifts = np.array(
        [max(int(e).bit_length() - BOX_BITS + 1, max_position_shift) for e in (high - low).max(axis=1)], dtype=np.int64
    )
    grid_corners = low >> shifts[:, None]
    return Boxes(shifts, grid_corners, (high >> shifts[:, None]) - grid_corners)


def block_codes(positions: np.ndarray, bits: int) -> np.ndarray:
    """Returns Morton codes of positions within a bounding box.

    Args:
        positions: int64 (n, 3), integer positions relative to the corner of the box.
        bits: Number of bits of a coordinate within the box.
    """
    codes = np.empty(len(positions), np.int64)
    used_bits = kernels.write_codes(np.ascontiguousarray(positions), max(bits - MAX_CELL_BITS, 0), codes)
    check_codes(used_bits, bits)
    return codes


def check_codes(used_bits: int, bits: int) -> None:
    """Raises ValueError if a position has no Morton code: a coordinate is negative or has too many bits.

    Args:
        used_bits: Bitwise OR of all coordinates, without the low bits that Morton codes omit.
        bits: Number of bits of a coordinate within the bounding box, for the error message.
    """
    if used_bits >> MAX_CELL_BITS:
        raise ValueError(f"positions must be in [0, 2**{bits}) to have a code")


def typical_cell_shift(means: np.ndarray, lattice_bits: int, size_log: int) -> int:
    """Estimates log2 of the cell size of a typical block (`choose_cell_shift`), from a sample of all Gaussians.

    Args:
        means: Positions of the scene's Gaussians, (N, 3).
        lattice_bits: `-log2` of the lattice spacing of positions, relative to the scene size.
        size_log: log2 of the scene size in world units.

    Returns:
        log2 of the cell size, in lattice spacings.
    """
    sample = means[:: -(-len(means) // TYPICAL_BLOCK_SAMPLE)]
    positions = to_lattice(sample.take(gaussian_order(sample, None), axis=0).astype(np.float64), lattice_bits, size_log)
    parts = min(max(1, len(means) // TYPICAL_BLOCK_GAUSSIANS), len(sample))
    edges = np.cumsum([0, *(len(part) for part in np.array_split(sample[:, 0], parts))])
    depth = 4 + (min(len(means), TYPICAL_BLOCK_GAUSSIANS).bit_length() + 1) // 2
    bits = [int(extent).bit_length() for extent in kernels.extents(positions, edges)]
    return int(np.clip(np.median(bits) - depth, 0, MAX_LATTICE_BITS - BOX_BITS))


def to_lattice(means: np.ndarray, lattice_bits: int, size_log: int) -> np.ndarray:
    """Converts positions to integer coordinates on a cubic lattice, rounded down, int64 (N, 3).

    Args:
        means: float64 (N, 3), positions.
        lattice_bits: Resolution of the lattice: the distance between its points is `2 ** -lattice_bits` times the
            scene size.
        size_log: log2 of the scene size in world units.

    Raises:
        InvalidValueError: If a position exceeds the range of the lattice.
    """
    scaled = np.floor(np.ldexp(means, lattice_bits - size_log))
    check_lattice_range(np.abs(scaled).max(initial=0))
    return scaled.astype(np.int64)


def check_lattice_range(max_coordinate: float) -> None:
    """Raises an error if a position exceeds the range of the lattice.

    Args:
        max_coordinate: Largest magnitude of a coordinate, in lattice spacings.

    Raises:
        InvalidValueError: If `max_coordinate` exceeds the range.
    """
    if max_coordinate >= 2.0**MAX_LATTICE_BITS:
        raise InvalidValueError("a Gaussian is too far away from the others for the precision of their positions")
