"""Blocks of Gaussians: which Gaussian lies at which place of a stream, and the box that each block's places are in."""

import functools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from splatwire.codec.schemas.gaussians.layout import MAX_CELL_BITS, MAX_LATTICE_BITS, SLOT_BITS
from splatwire.errors import InvalidValueError
from splatwire.ops.code_order import code_order
from splatwire.ops.morton import MAX_AXIS_BITS, morton_encode
from splatwire.ops.order_statistics import quantiles
from splatwire.packets import PacketPlan

ROWS = 1 << 16
_OUTSIDE, _MARGIN = 50, 2
"""Cells are for what lies between the outermost 2 % at either end of each axis, and for twice as much at most."""
TYPICAL_BLOCK, TYPICAL_SAMPLE = 3000, 1 << 14
"""Gaussians of a usual block, and of the sample that shows how large such blocks are."""
BOX_BITS = 8
"""A box is so many bits large in its own unit."""


@dataclass(frozen=True, eq=False)
class Boxes:
    """Boxes of B blocks.

    Attributes:
        shifts: int64 (B), log2 of each box's unit, in lattice units.
        origins: int64 (B, 3), lower corner, in the box's units.
        extents: int64 (B, 3), sides in the box's units, less one.
    """

    shifts: np.ndarray
    origins: np.ndarray
    extents: np.ndarray

    @functools.cached_property
    def bits(self) -> np.ndarray:
        """Bits of a coordinate within each box, int64 (B)."""
        return self.shifts + np.array(
            [int(e).bit_length() for e in self.extents.max(axis=1, initial=0)], dtype=np.int64
        )

    @functools.cached_property
    def corners(self) -> np.ndarray:
        """Lower corners in lattice units, int64 (B, 3)."""
        return self.origins << self.shifts[:, None]


def runs(values: np.ndarray) -> Iterator[np.ndarray]:
    """Some rows of an array at a time: beside the array itself, millions of Gaussians take little memory."""
    for begin in range(0, len(values), ROWS):
        yield values[begin : begin + ROWS]


def pieces(values: np.ndarray) -> Iterator[np.ndarray]:
    """Rows of an array as float64, some at a time."""
    return (some.astype(np.float64) for some in runs(values))


def gaussian_order(means: np.ndarray, tiers: np.ndarray | None) -> np.ndarray:
    """Sorts Gaussians along a Morton curve, the most important tier first, uint32 (N).

    Args:
        means: (N, 3).
        tiers: Tier of each; None for one.
    """
    found = [quantiles(functools.partial(runs, column), len(means), (0.01, 0.99)) for column in means.T]
    low, high = np.stack(found, axis=1)
    middle, spread = (low + high) / 2, max(float((high - low).max()), 1e-30)

    def near(some: np.ndarray) -> np.ndarray:
        """What lies far outside is drawn near, so that it does not make the cells of the rest large."""
        return np.arcsinh((some - middle) / spread * 2)

    first, last = near(np.array([means.min(axis=0), means.max(axis=0)], dtype=np.float64))
    size = max(float((last - first).max()), 1e-30)

    def codes(some: np.ndarray) -> np.ndarray:
        places = near(means.take(some, axis=0).astype(np.float64))
        return morton_encode(np.rint((places - first) / size * ((1 << MAX_AXIS_BITS) - 1)).astype(np.int64))

    return code_order(codes, len(means), 3 * MAX_AXIS_BITS, tiers)


def block_sizes(plan: PacketPlan) -> np.ndarray:
    """Gaussians of each block, int64 (B)."""
    return np.array([plan.block_elements(block) for block in range(plan.num_blocks)], dtype=np.int64)


def cell_shift(places: np.ndarray, bits: int) -> int:
    """How large cells are, as log2 in lattice units: some sixteen to a side for each Gaussian on a surface.

    A few that lie far outside do not make the cells of all others large.

    Args:
        places: int64 (n, 3), within the block's box.
        bits: Bits of the box.
    """
    depth = 4 + (len(places).bit_length() + 1) // 2
    return max(_extent_bits(places) - depth, bits - MAX_CELL_BITS, 0)


def _extent_bits(places: np.ndarray) -> int:
    """Bits of the extent of what does not lie far outside."""
    ends = [(len(places) - 1) // _OUTSIDE, len(places) - 1 - (len(places) - 1) // _OUTSIDE]
    axes = np.ascontiguousarray(places.T)
    low, high = np.partition(axes, ends, axis=1)[:, ends].T
    return int(np.minimum(np.ptp(axes, axis=1), _MARGIN * (high - low)).max()).bit_length()


def arrange_block(codes: np.ndarray, contiguous: bool) -> np.ndarray:
    """Which Gaussian of a block lies where: indices in the order in which packets are filled.

    Args:
        codes: int64 (n), Morton codes of the cells that the block's Gaussians are in.
        contiguous: Whether packets hold Gaussians that lie together. Otherwise each is spread evenly over the block, so
            that its loss leaves small holes everywhere instead of one large one.
    """
    if contiguous:
        return np.argsort(codes, kind="stable")
    slots = np.zeros_like(codes)
    for bit in range(SLOT_BITS):
        slots |= ((codes >> bit) & 1) << (SLOT_BITS - 1 - bit)
    top = int(codes.max(initial=0)).bit_length()
    return np.argsort(slots << top | codes, kind="stable") if top < 63 - SLOT_BITS else np.lexsort((codes, slots))


def make_boxes(low: np.ndarray, high: np.ndarray, coarsest: int = 0) -> Boxes:
    """Boxes around what lies from `low` to `high`, int64 (B, 3) each, in lattice coordinates.

    Their corners are multiples of `1 << coarsest`, so that cells of places are the same in every box.
    """
    shifts = np.array(
        [max(int(e).bit_length() - BOX_BITS + 1, coarsest) for e in (high - low).max(axis=1)], dtype=np.int64
    )
    origins = low >> shifts[:, None]
    return Boxes(shifts, origins, (high >> shifts[:, None]) - origins)


def block_codes(places: np.ndarray, bits: int) -> np.ndarray:
    """Morton codes of places within a box of so many bits, of at most `MAX_CELL_BITS` bits to an axis."""
    return morton_encode(places >> max(bits - MAX_CELL_BITS, 0))


def typical_cell(means: np.ndarray, unit: int, size_log: int) -> int:
    """About as large as `cell_shift` makes cells in most blocks, whatever blocks there will be.

    Args:
        means: (N, 3).
        unit: `-log2` of the lattice's unit, relative to the scene's size.
        size_log: log2 of the scene's size.
    """
    some = means[:: -(-len(means) // TYPICAL_SAMPLE)]
    order = gaussian_order(some, None)
    parts = np.array_split(order, max(1, len(means) // TYPICAL_BLOCK))
    places = [to_lattice(some.take(part, axis=0).astype(np.float64), unit, size_log) for part in parts]
    depth = 4 + (min(len(means), TYPICAL_BLOCK).bit_length() + 1) // 2
    bits = [_extent_bits(place) for place in places if len(place)]
    return int(np.clip(np.median(bits) - depth, 0, MAX_LATTICE_BITS - BOX_BITS))


def to_lattice(means: np.ndarray, unit: int, size_log: int) -> np.ndarray:
    """Cells of the lattice that places lie in, int64 (N, 3).

    Raises:
        InvalidValueError: If a place is too far away for the lattice.
    """
    scaled = np.floor(np.ldexp(means, unit - size_log))
    if np.abs(scaled).max(initial=0) >= 2.0**MAX_LATTICE_BITS:
        raise InvalidValueError("a Gaussian is too far away from the others for the precision of their places")
    return scaled.astype(np.int64)
