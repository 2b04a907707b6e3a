"""Input of the Gaussian encoder: Gaussians sorted into blocks, with quantised positions and precision classes."""

import functools
import operator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from splatwire.bitstream import PacketPlan
from splatwire.codec.gaussians import _gaussian_kernels as kernels
from splatwire.codec.gaussians import _source_kernels as sources
from splatwire.codec.gaussians.attributes import GREY, LUMA_CHROMA, kernel_array, log2_scene_size, to_logs
from splatwire.codec.gaussians.blocks import (
    CACHE_GAUSSIANS,
    block_sizes,
    check_codes,
    check_lattice_range,
    choose_cell_shift,
    chunks,
    gaussian_order,
    typical_cell_shift,
)
from splatwire.codec.gaussians.layout import (
    ASSUMED_ELONGATION,
    BITS,
    COEFFICIENTS,
    MAX_CELL_BITS,
    MAX_FLATNESS,
    STEP_BITS,
    STEP_FLATNESS,
    STEP_POSITION,
    STEP_SCALE0,
)
from splatwire.codec.gaussians.outliers import MAX_COORDINATE_BITS, log_clipped_colours, pull_in_outliers
from splatwire.codec.gaussians.quality import Quality
from splatwire.codec.gaussians.side_info import MEAN_SHIFT, SideInfo
from splatwire.codec.gaussians.tables import flatness_table
from splatwire.errors import InvalidValueError
from splatwire.files.mmap_array import large_empty
from splatwire.ops.sort3 import sort3
from splatwire.ops.spherical_harmonics import DC
from splatwire.ops.threads import parallel_map
from splatwire.types import SplatCoding
from splatwire.types.splats import Splats

FITTED_BLOCKS = 32
"""Maximum number of blocks to which context tables and the transform of spherical harmonics are fitted; these blocks
are spread over the scene.
"""

_MAX_FLAT_STEP_BITS = 8
"""log2 of the coarsest quantisation step that keeps flat Gaussians flat, for the companded ratio of the second to the
third scale.
"""
POINT_OCTAVES = 20
"""Gaussians smaller than the scene by more than this number of octaves count as points, which are ignored when
quantisation steps are adapted to the scene.
"""


class BlockSource(NamedTuple):
    """Input of the encoding kernels: n Gaussians of one block, in the order in which packets are filled.

    Attributes:
        cell_shift: log2 of the cell size of the coarse position grid, in the unit of `positions`.
        spread: 1 if each packet has Gaussians from all over the block, 0 if a packet contains adjacent Gaussians.
        codes: int64 (n), Morton codes of the positions, from `write_block_positions`.
        positions: int64 (n, 3), positions relative to the corner of the block's bounding box, in spacings of the
            position lattice.
        precision_classes: int64 (n), which select the quantisation steps; 0 is the coarsest.
        logs: int64 (n, 4), fixed-point logarithms of opacity and scales.
        axes: float64 (n, 3, 3), principal axes.
        colours: int64 (n, 3), base colours as Y Co Cg in fixed point.
        harmonics: int32 (n, harmonics), transformed and rounded spherical harmonics, from `gather_sources`.
    """

    cell_shift: np.int64
    spread: np.int64
    codes: np.ndarray
    positions: np.ndarray
    precision_classes: np.ndarray
    logs: np.ndarray
    axes: np.ndarray
    colours: np.ndarray
    harmonics: np.ndarray


@dataclass(frozen=True, eq=False)
class SourceScene:
    """Gaussians of a scene as input of the encoder, sorted into B blocks.

    Attributes:
        splats: The N Gaussians in input order.
        centres: float32 (N, 3), positions as a decoder obtains them, in input order.
        order: uint32 (N), indices in `splats` of the Gaussians of block 0, then of block 1, and so on. An index in this
            array is a *sorted position*.
        edges: int64 (B + 1); block b contains the Gaussians `order[edges[b]:edges[b + 1]]`.
        precision_classes: uint8 (N), in input order, which select the quantisation steps; 0 is the coarsest.
        size_log: log2 of the scene size: the median distance of the Gaussians from their median position, rounded down
            to a power of two, in world units (`log2_scene_size`).
        lattice_bits: Resolution of positions. Positions are multiples of half a lattice spacing; the spacing is
            `2 ** (size_log - lattice_bits)` world units.
        base_exponents: int64 (9), `-log2` of the quantisation step of each quantity in `layout.STEPS`, for precision
            class 0 (the coarsest), in fixed point with `STEP_BITS` fractional bits.
        max_position_shift: log2 of the largest quantisation step of positions, in lattice spacings.
        contiguous: True if a packet contains adjacent Gaussians, False if it has Gaussians from all over its block.
    """

    splats: Splats
    centres: np.ndarray
    order: np.ndarray
    edges: np.ndarray
    precision_classes: np.ndarray
    size_log: int
    lattice_bits: int
    base_exponents: np.ndarray
    max_position_shift: int
    contiguous: bool

    @staticmethod
    def of(
        splats: Splats,
        plan: PacketPlan,
        class_offsets: np.ndarray | None,
        tiers: np.ndarray | None,
        quality: Quality,
        coding: SplatCoding | None = None,
        *,
        sorted_already: bool = False,
        max_lattice_bits: int = MAX_COORDINATE_BITS,
    ) -> "SourceScene":
        """Sorts Gaussians into the blocks of a packet plan, and chooses their quantisation steps.

        Args:
            splats: The Gaussians.
            plan: Packet plan with the number of Gaussians in each block.
            class_offsets: Class offset of each Gaussian, which selects its quantisation steps: 0 for the finest,
                negative for coarser ones. None to use the finest for all. Ignored if `coding` is given.
            tiers: Importance tier of each Gaussian, 0 for the most important; None to treat all as equally important.
            quality: Quality setting; ignored if `coding` is given.
            coding: Quantisation parameters of a decoded scene, to obtain the same integers again; None to choose them.
            sorted_already: True if `splats` is sorted by block already, so that the order is kept.
            max_lattice_bits: Upper limit of the chosen `lattice_bits`. Ignored if `coding` is given.
        """
        if coding is not None:
            size_log, lattice_bits, max_position_shift = coding.size_log, coding.lattice_bits, coding.max_position_shift
            base_exponents, precision_classes = np.array(coding.base_exponents), coding.precision_classes
        else:
            size_log = log2_scene_size(splats)
            splats = pull_in_outliers(splats, size_log)
            log_clipped_colours(splats)
            base_exponents = _step_exponents(splats, quality, size_log)
            finest_class = quality.num_classes(splats.degree) - 1
            precision_classes = refine_flat_classes(
                splats,
                to_precision_classes(class_offsets, splats.num_gaussians, finest_class),
                finest_class,
                base_exponents,
                size_log,
            )
            chosen_bits = _choose_lattice_bits(splats, precision_classes, base_exponents, size_log)
            lattice_bits = min(chosen_bits, max_lattice_bits)
            # The bits of a cell would be wasted if a position step were larger than the cell.
            max_position_shift = typical_cell_shift(splats.means, lattice_bits, size_log)
        centres = _quantised_positions(
            splats, precision_classes, base_exponents, size_log, lattice_bits, max_position_shift
        )
        order = _input_order(len(centres)) if sorted_already else gaussian_order(centres, tiers)
        edges = np.concatenate([[0], np.cumsum(block_sizes(plan))]).astype(np.int64)
        return SourceScene(
            splats,
            centres,
            order,
            edges,
            precision_classes,
            size_log,
            lattice_bits,
            base_exponents,
            max_position_shift,
            plan.packetization.grouping == "contiguous",
        )

    @property
    def num_blocks(self) -> int:
        """Number of blocks, B."""
        return len(self.edges) - 1

    def sample_blocks(self) -> list[int]:
        """Returns the indices of a sample of blocks, used by an encoder to fit probability tables."""
        return np.unique(np.linspace(0, self.num_blocks - 1, min(self.num_blocks, FITTED_BLOCKS)).astype(int)).tolist()

    def block_range(self, block: int) -> slice:
        """Returns the range of the sorted positions of a block's Gaussians, their indices in the attribute `order`."""
        return slice(int(self.edges[block]), int(self.edges[block + 1]))

    def splats_at(self, sorted_positions: slice | np.ndarray) -> Splats:
        """Returns the Gaussians at the given sorted positions.

        Args:
            sorted_positions: Indices in the attribute `order`, as a range or an array of integers.
        """
        # numpy's `take` is several times as fast as indexing with brackets.
        return self.splats.select(self.order[sorted_positions])

    def classes_at(self, sorted_positions: slice | np.ndarray) -> np.ndarray:
        """Returns the precision classes of the Gaussians at the given sorted positions, int64.

        Args:
            sorted_positions: Indices in the attribute `order`, as a range or an array of integers.
        """
        return self.precision_classes[self.order[sorted_positions]].astype(np.int64)

    def summary(self, block: int) -> tuple[np.ndarray, np.ndarray]:
        """Returns the bounding box and the mean attributes of a block's Gaussians.

        Args:
            block: Index of the spatial block.

        Returns:
            Smallest and largest coordinates in lattice spacings, int64 (2, 3); and means of the seven coded quantities
            (see `summarise_block`), int64 (7), multiples of `1 << MEAN_SHIFT`.
        """
        members = self.order[self.block_range(block)]
        splats, indices = self._kernel_splats(members)
        bounds, means = np.empty((2, 3), np.int64), np.empty(7)
        centres = self.centres if indices is members else self.centres.take(members, axis=0)
        check_lattice_range(
            sources.summarise_block(
                indices, centres, splats.scales, splats.opacities, splats.sh, self._spacings_per_unit, self.size_log,
                LUMA_CHROMA * DC, GREY, np.empty((2, 4), np.int64), bounds, means,
            )
        )  # fmt: skip
        return bounds, np.rint(means / (1 << MEAN_SHIFT)).astype(np.int64) << MEAN_SHIFT

    @property
    def _spacings_per_unit(self) -> float:
        """Number of lattice spacings per world unit, a power of two."""
        return 2.0 ** (self.lattice_bits - self.size_log)

    def _kernel_splats(self, indices: np.ndarray) -> tuple[Splats, np.ndarray]:
        """Returns some Gaussians in the array layout for which kernels are compiled.

        Args:
            indices: Indices of the Gaussians in `splats`.

        Returns:
            Arrays with this layout, and the row of each selected Gaussian in the arrays. If `splats` has the layout
            already, the result is `splats` and `indices`. Otherwise, the arrays are a converted copy of only the
            selected Gaussians, and the rows are 0, 1, 2, and so on.
        """
        if self._kernels_read_splats:
            return self.splats, indices
        arrays = {name: kernel_array(values) for name, values in vars(self.splats.select(indices)).items()}
        return Splats(**arrays), np.arange(len(indices), dtype=indices.dtype)

    @functools.cached_property
    def _kernels_read_splats(self) -> bool:
        """True if the scene's arrays have the layout for which kernels are compiled (`kernel_array`)."""
        arrays = (*vars(self.splats).values(), self.centres)
        return all(a.dtype == np.float32 and a.flags.c_contiguous and a.flags.writeable for a in arrays)

    def _block_positions(self, block: int, info: SideInfo) -> tuple[np.ndarray, np.ndarray, int, np.ndarray]:
        """Returns the positions of a block's n Gaussians as integers, and the order of the Gaussians in packets.

        Args:
            block: Index of the spatial block.
            info: Side information with the bounding boxes of blocks.

        Returns:
            Four items:

            * Positions relative to the corner of the block's bounding box, in spacings of the position lattice, int64
              (n, 3). Rows are in the order of `block_range(block)`.
            * Morton code of each row, int64 (n).
            * log2 of the cell size of the coarse position grid, in lattice spacings.
            * Rows in the order in which their Gaussians are put into packets, int64 (n).
        """
        members, bits = self.order[self.block_range(block)], int(info.boxes.bits[block])
        positions, codes = np.empty((len(members), 3), np.int64), np.empty(len(members), np.int64)
        centres, dropped_bits = kernel_array(self.centres), max(bits - MAX_CELL_BITS, 0)
        max_coordinate, used_bits = sources.write_block_positions(
            members, centres, self._spacings_per_unit, info.boxes.corners[block], dropped_bits, positions, codes
        )
        check_lattice_range(max_coordinate)
        check_codes(used_bits, bits)
        cell_shift = choose_cell_shift(positions, bits)
        return positions, codes, cell_shift, sources.sort_cells(codes, 3 * (cell_shift - dropped_bits), self.contiguous)

    def packet_order(self, block: int, info: SideInfo, counts: np.ndarray) -> np.ndarray:
        """Returns a block's Gaussians in packet order: packet by packet, and along a Morton curve within a packet.

        The i-th Gaussian in this order gets the plan index `PacketPlan.block_indices(block)[i]`, its index in the
        decoded scene.

        Args:
            block: Index of the spatial block.
            info: Side information with the bounding boxes of blocks.
            counts: Number of Gaussians in each packet of the block.

        Returns:
            Entry i is the index in `splats` of the i-th Gaussian in packet order, int64 (n).
        """
        _, codes, _, order = self._block_positions(block, info)
        # Within a packet Gaussians are sorted along the curve, as in the kernels.
        packet = np.repeat(np.arange(len(counts)), counts)
        return self.order[self.block_range(block).start + order[np.lexsort((codes[order], packet))]].astype(np.int64)

    def block_source(self, block: int, info: SideInfo, selection: slice | np.ndarray = slice(None)) -> BlockSource:
        """Returns a block's Gaussians as input of the encoding kernels, in the order in which packets are filled.

        If quantisation makes all harmonics of a Gaussian 0, the result contains 0 in place of its transformed
        harmonics.

        Args:
            block: Index of the spatial block.
            info: Side information with the bounding boxes, the transform of spherical harmonics and the quantisation
                steps.
            selection: Gaussians to return, as a range or as indices in the order in which packets are filled; all by
                default.
        """
        positions, codes, cell_shift, order = self._block_positions(block, info)
        order = order[selection]
        members = self.order[self.block_range(block)].take(order)
        splats, indices = self._kernel_splats(members)
        precision_classes, count = self.precision_classes.take(members).astype(np.int64), len(order)
        logs, axes, colours = np.empty((count, 4), np.int64), np.empty((count, 3, 3)), np.empty((count, 3), np.int64)
        harmonics = np.empty((count, info.num_harmonic_columns), np.int32)
        inverse, zero_thresholds = info.harmonics_inverse
        sources.gather_sources(
            indices, splats.quats, splats.scales, splats.opacities, splats.sh, self.size_log, LUMA_CHROMA * DC, GREY,
            LUMA_CHROMA * (1 << BITS), inverse, zero_thresholds, np.empty((6, inverse.shape[1])), precision_classes,
            logs, axes, colours, harmonics,
        )  # fmt: skip
        return BlockSource(
            np.int64(cell_shift), np.int64(not self.contiguous), codes.take(order), positions.take(order, axis=0),
            precision_classes, logs, axes, colours, harmonics,
        )  # fmt: skip


def _input_order(count: int) -> np.ndarray:
    order = large_empty((count,), np.uint32)
    order[:] = np.arange(count, dtype=np.uint32)
    return order


def to_precision_classes(class_offsets: np.ndarray | None, count: int, finest_class: int) -> np.ndarray:
    """Converts class offsets, the numbering of encoder options, to precision classes, the numbering of the bitstream.

    Args:
        class_offsets: Class offset of each Gaussian, (N): its precision class relative to the finest one; 0 for the
            finest, negative for coarser ones. None for the finest class for all Gaussians.
        count: Number of Gaussians, N.
        finest_class: Number of the finest precision class in the bitstream, where 0 is the coarsest.

    Returns:
        Class of each Gaussian in the bitstream, uint8 (N), from 0 to `finest_class`.

    Raises:
        InvalidValueError: If the number of classes differs from the number of Gaussians.
    """
    if class_offsets is None:
        return np.broadcast_to(np.uint8(finest_class), count)
    if np.shape(class_offsets) != (count,):
        raise InvalidValueError(f"{np.shape(class_offsets)} classes of precision for {count} Gaussians")
    precision_classes = large_empty((count,), np.uint8)
    for output, piece in zip(chunks(precision_classes), chunks(np.asarray(class_offsets)), strict=True):
        output[:] = np.clip(piece, -finest_class, 0) + finest_class
    return precision_classes


def refine_flat_classes(
    splats: Splats, precision_classes: np.ndarray, finest_class: int, base_exponents: np.ndarray, size_log: int
) -> np.ndarray:
    """Assigns a finer precision class to flat Gaussians that rounding would make much thicker.

    Args:
        splats: The N Gaussians.
        precision_classes: uint8 (N), from `to_precision_classes`.
        finest_class: The finest precision class; 0 is the coarsest.
        base_exponents: `-log2` of the quantisation steps in precision class 0 (the coarsest), in fixed point.
        size_log: log2 of the scene size in world units.

    Returns:
        The changed precision classes, uint8 (N).
    """
    # With a coarse step, the smallest scale of a flat Gaussian can become 31 % of the second scale. With the returned
    # classes, it is at most 0.4 % where the finest class suffices for that; other Gaussians get the finest class.
    flat = np.concatenate(
        [np.flatnonzero(_is_flat(piece)) + n * CACHE_GAUSSIANS for n, piece in enumerate(chunks(splats.scales))]
    )
    if not len(flat):
        return precision_classes
    logs = to_logs(splats.select(flat), size_log) / (1 << BITS)
    opacity, s0, elongation = logs[:, 0], logs[:, 1], logs[:, 1] - logs[:, 2]
    predictors = np.stack([2 * s0 - elongation, elongation, np.zeros(len(flat)), opacity])
    exponents = (COEFFICIENTS[STEP_FLATNESS] @ predictors + base_exponents[STEP_FLATNESS]) / (1 << STEP_BITS)
    # The margin covers the rounding of the exponent and of its inputs.
    min_class = np.ceil(BITS - _MAX_FLAT_STEP_BITS - 0.25 - exponents)
    refined = precision_classes.copy()
    refined[flat] = np.maximum(precision_classes[flat], np.clip(min_class, 0, finest_class)).astype(np.uint8)
    return refined


def _is_flat(scales: np.ndarray) -> np.ndarray:
    """Returns the mask of Gaussians that are flatter than the format can represent."""
    low, middle, _ = sort3(scales)
    return low < middle * np.float32(2.0**-MAX_FLATNESS)


def _step_exponents(splats: Splats, quality: Quality, size_log: int) -> np.ndarray:
    """Returns `-log2` of the quantisation steps of all attributes in precision class 0 (the coarsest), in fixed point.

    They are the steps of a Gaussian with scales (relative to the scene size) and opacity 1. The step of the largest
    scale is adapted to the mean scale of the Gaussians.
    """
    base_exponents = quality.base_exponents(splats.degree)
    parts = list(chunks(splats.scales))
    min_size = np.float32(2.0 ** (size_log - POINT_OCTAVES))

    def sizes(scales: np.ndarray) -> tuple[float, int]:
        largest = scales.max(axis=1)
        largest = largest[largest > min_size].astype(np.float64)
        return float(np.log2(largest).sum()), len(largest)

    totals = parallel_map(sizes, parts)
    # Explicit order of addition: `sum` rounds differently from Python 3.12 on.
    total = functools.reduce(operator.add, (logs for logs, _ in totals), 0.0)
    count = sum(number for _, number in totals)
    mean_log_largest = total / count - size_log if count else -POINT_OCTAVES
    # A decoder does not know a Gaussian's area yet when it decodes the largest scale: the scene's mean area stands in.
    mean_log_area = 2 * mean_log_largest - (ASSUMED_ELONGATION >> BITS)
    base_exponents[STEP_SCALE0] += np.rint(COEFFICIENTS[STEP_SCALE0, 0] * mean_log_area).astype(np.int64)
    return base_exponents


def _quantised_positions(
    splats: Splats,
    precision_classes: np.ndarray,
    base_exponents: np.ndarray,
    size_log: int,
    lattice_bits: int,
    max_position_shift: int,
) -> np.ndarray:
    """Returns the positions of the Gaussians as a decoder obtains them, float32 (N, 3).

    Raises:
        InvalidValueError: If a position exceeds the range of the lattice.
    """
    centres, table = large_empty((splats.num_gaussians, 3), np.float32), flatness_table()

    def round_slice(begin: int) -> None:
        output = centres[begin : begin + CACHE_GAUSSIANS]
        piece, shifts = splats.slice_range(begin, begin + len(output)), np.empty(len(output), np.int64)
        piece_classes = precision_classes[begin : begin + len(output)].astype(np.int64)
        kernels.position_shifts(
            to_logs(piece, size_log),
            piece_classes,
            base_exponents,
            lattice_bits,
            max_position_shift,
            table,
            shifts,
        )
        output[:] = piece.means
        check_lattice_range(
            sources.round_positions(
                output, shifts, 2.0 ** (lattice_bits - size_log), 2.0 ** (size_log - lattice_bits - 1)
            )
        )

    parallel_map(round_slice, range(0, len(centres), CACHE_GAUSSIANS))
    return centres


def _choose_lattice_bits(
    splats: Splats, precision_classes: np.ndarray, base_exponents: np.ndarray, size_log: int
) -> int:
    """Chooses the lattice of positions; returns `-log2` of the ratio of its spacing to the scene size.

    The spacing is the finest quantisation step of any position, rounded down to a power of two. If some coordinates
    would then exceed the range of the lattice, the spacing is larger, but never larger than the scene size.
    """
    c, exponent = COEFFICIENTS[STEP_POSITION] / (1 << STEP_BITS), base_exponents[STEP_POSITION] / (1 << STEP_BITS)

    def finest_exponent(arrays: tuple[np.ndarray, np.ndarray]) -> float:
        scales, piece_classes = (values.astype(np.float64) for values in arrays)
        _, middle, largest = (logs - size_log for logs in sort3(np.log2(scales)))
        exponents = exponent + piece_classes + c[0] * (largest + middle) + c[1] * (largest - middle)
        return float(np.maximum(exponents, 1 - middle).max())

    pieces = list(zip(chunks(splats.scales), chunks(precision_classes), strict=True))
    max_exponent = max(parallel_map(finest_exponent, pieces), default=-np.inf)
    log_max_coordinate = np.log2(float(np.abs(splats.means).max()) + 1e-30) - size_log
    max_bits = max(min(MAX_COORDINATE_BITS - np.ceil(log_max_coordinate), MAX_COORDINATE_BITS), 0)
    return int(np.clip(np.ceil(max_exponent), 0, max_bits))
