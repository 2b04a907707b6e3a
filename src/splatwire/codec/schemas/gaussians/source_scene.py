"""What an encoder makes packets of: Gaussians sorted into blocks, their places on the lattice, their classes."""

import functools
import operator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from splatwire.codec.schemas.gaussians.attributes import (
    scene_log,
    to_colours,
    to_logs,
    to_sources,
    transformed,
)
from splatwire.codec.schemas.gaussians.blocks import (
    ROWS,
    arrange_block,
    block_codes,
    block_sizes,
    cell_shift,
    gaussian_order,
    runs,
    to_lattice,
    typical_cell,
)
from splatwire.codec.schemas.gaussians.layout import (
    BITS,
    COEFFICIENTS,
    MAX_CELL_BITS,
    MAX_THINNESS,
    S_POSITION,
    S_SCALE0,
    S_SCALE2,
    STEP_BITS,
)
from splatwire.codec.schemas.gaussians.outliers import ROOM, tell_cut_colours, within_reach
from splatwire.codec.schemas.gaussians.quality import Quality
from splatwire.codec.schemas.gaussians.side_info import DEFAULT_SHIFT, SideInfo
from splatwire.codec.schemas.gaussians.tables import thinness_table
from splatwire.errors import InvalidValueError
from splatwire.files.large import large_empty
from splatwire.model import SplatCoding
from splatwire.ops.rising import rising
from splatwire.ops.threads import share
from splatwire.packets import PacketPlan
from splatwire.scene.splats import Splats

FITTED_BLOCKS = 32
"""The transform of harmonics and the tables are fitted to parts of at most so many blocks, spread over the scene."""

_FLAT_SHIFT = 8
"""log2 of the coarsest step of companded ratios of scales for flat Gaussians."""
SMALLEST = 20
"""Octaves below the scene's size from which on Gaussians are points, which steps are not fitted to."""


class BlockSource(NamedTuple):
    """What the kernels encode of a block: n Gaussians in the order in which packets are filled.

    Attributes:
        cells_at: log2 of the size of cells, in lattice units.
        spread: 1 if packets are spread over the block, 0 if they hold what lies together.
        codes: int64 (n), Morton codes of the places (`block_codes`).
        places: int64 (n, 3), within the block's box, in lattice units.
        classes: int64 (n), of precision, 0 for the least.
        logs: int64 (n, 4), see `Sources`, as the next ones.
        axes: float64 (n, 3, 3).
        colours: int64 (n, 3).
        harmonics: int64 (n, M), see `transformed`.
    """

    cells_at: np.int64
    spread: np.int64
    codes: np.ndarray
    places: np.ndarray
    classes: np.ndarray
    logs: np.ndarray
    axes: np.ndarray
    colours: np.ndarray
    harmonics: np.ndarray


@dataclass(frozen=True, eq=False)
class SourceScene:
    """Gaussians sorted into blocks; a block's integers are made when they are needed.

    Attributes:
        splats: The Gaussians as they came.
        centres: float32 (N, 3), their places as a decoder will have them.
        order: Integers (N), the Gaussians block by block.
        edges: int64 (B + 1), where blocks begin in `order`.
        classes: uint8 (N), classes of precision as Gaussians came, 0 for the least.
        size_log: log2 of the scene's size.
        unit: `-log2` of the lattice's unit, relative to it.
        bases: int64, by `STEPS`, see `SideInfo`.
        coarsest: See `SideInfo`.
        contiguous: Whether packets hold Gaussians that lie together.
    """

    splats: Splats
    centres: np.ndarray
    order: np.ndarray
    edges: np.ndarray
    classes: np.ndarray
    size_log: int
    unit: int
    bases: np.ndarray
    coarsest: int
    contiguous: bool

    @staticmethod
    def of(
        splats: Splats,
        plan: PacketPlan,
        classes: np.ndarray | None,
        tiers: np.ndarray | None,
        quality: Quality,
        coding: SplatCoding | None = None,
        *,
        sorted_already: bool = False,
        most_unit: int = ROOM,
    ) -> "SourceScene":
        """Sorts Gaussians into the blocks of a plan, see `prepare_splats`; `most_unit` is the most `unit` may be."""
        if coding is not None:
            size_log, unit, coarsest = coding.size_log, coding.unit, coding.coarsest
            bases, levels = np.array(coding.bases), coding.classes
        else:
            size_log = scene_log(splats)
            splats = within_reach(splats, size_log)
            tell_cut_colours(splats)
            bases = _bases(splats, quality, size_log)
            most = quality.classes_of(splats.degree) - 1
            levels = _levels_of_flat(splats, levels_of(classes, splats.num_gaussians, most), most, bases, size_log)
            unit = min(_lattice_unit(splats, levels, bases, size_log), most_unit)
            coarsest = typical_cell(splats.means, unit, size_log)
        centres = _centres(splats, levels, bases, size_log, unit, coarsest)
        order = _as_they_come(len(centres)) if sorted_already else gaussian_order(centres, tiers)
        edges = np.concatenate([[0], np.cumsum(block_sizes(plan))]).astype(np.int64)
        return SourceScene(
            splats,
            centres,
            order,
            edges,
            levels,
            size_log,
            unit,
            bases,
            coarsest,
            plan.packetization.grouping == "contiguous",
        )

    @property
    def num_blocks(self) -> int:
        """Blocks, B."""
        return len(self.edges) - 1

    def some_blocks(self) -> list[int]:
        """Blocks that tables are fitted to."""
        return np.unique(np.linspace(0, self.num_blocks - 1, min(self.num_blocks, FITTED_BLOCKS)).astype(int)).tolist()

    def members(self, block: int) -> slice:
        """Where a block's Gaussians are in `order`."""
        return slice(int(self.edges[block]), int(self.edges[block + 1]))

    def pick(self, where: slice | np.ndarray) -> Splats:
        """The Gaussians at some places of `order`."""
        # numpy's `take` is several times as fast as an index into a tensor.
        return self.splats.select(self.order[where])

    def classes_at(self, where: slice | np.ndarray) -> np.ndarray:
        """Classes of precision of those at some places of `order`, int64."""
        return self.classes[self.order[where]].astype(np.int64)

    def places(self, block: int) -> np.ndarray:
        """Lattice coordinates of a block's Gaussians, int64 (n, 3), as they come in `order`."""
        means = self.centres.take(self.order[self.members(block)], axis=0)
        return to_lattice(means.astype(np.float64), self.unit, self.size_log)

    def ends(self, block: int) -> np.ndarray:
        """Lower and upper ends of a block's places, int64 (2, 3)."""
        places = self.places(block)
        return np.array([places.min(axis=0), places.max(axis=0)])

    def means(self, block: int) -> np.ndarray:
        """Means of a block's opacity, scales as they are sent, and colour, in sixteenths."""
        here = self.pick(self.members(block))
        logs = to_logs(here, self.size_log).astype(np.float64)
        ratio = (logs[:, 2] - logs[:, 3]) / (1 << BITS)
        thin = (1 - 2.0**-ratio) / np.log(2) * (1 << BITS)
        values = np.stack([logs[:, 0], logs[:, 1], logs[:, 1] - logs[:, 2], thin], axis=1)
        means = np.concatenate([values.mean(axis=0), to_colours(here).mean(axis=0)])
        return np.rint(means / (1 << DEFAULT_SHIFT)).astype(np.int64)

    def ranked(self, block: int, info: SideInfo, sizes: np.ndarray) -> np.ndarray:
        """Which Gaussian is at which place of a block that was cut into packets of these sizes, int64 (n)."""
        bits = int(info.boxes.bits[block])
        places = self.places(block) - info.boxes.corners[block]
        codes, at = block_codes(places, bits), cell_shift(places, bits)
        by = self._arrangement(codes, at, bits)
        # Within a packet they lie along the curve, as the kernels sort them.
        packet = np.repeat(np.arange(len(sizes)), sizes)
        return self.order[self.members(block).start + by[np.lexsort((codes[by], packet))]].astype(np.int64)

    def _arrangement(self, codes: np.ndarray, at: int, bits: int) -> np.ndarray:
        """Order in which packets of a block are filled, from the Morton codes of its places."""
        return arrange_block(codes >> 3 * (at - max(bits - MAX_CELL_BITS, 0)), self.contiguous)

    def arranged(self, block: int, info: SideInfo, some: slice | np.ndarray = slice(None)) -> BlockSource:
        """What the kernels encode of a block, in the order in which packets are filled, or `some` of it."""
        bits = int(info.boxes.bits[block])
        places = self.places(block) - info.boxes.corners[block]
        codes, at = block_codes(places, bits), cell_shift(places, bits)
        by = self._arrangement(codes, at, bits)[some]
        where = self.members(block).start + by
        s = to_sources(self.pick(where), self.size_log)
        return BlockSource(
            np.int64(at),
            np.int64(not self.contiguous),
            codes[by],
            places[by],
            self.classes_at(where),
            s.logs,
            s.axes,
            s.colours,
            transformed(s.harmonics, info.transform),
        )


def _as_they_come(count: int) -> np.ndarray:
    order = large_empty((count,), np.uint32)
    order[:] = np.arange(count, dtype=np.uint32)
    return order


def levels_of(classes: np.ndarray | None, count: int, most: int) -> np.ndarray:
    """Classes as they are sent, 0 for the least precise of `most + 1`, uint8 (N); None stands for the finest.

    Raises:
        InvalidValueError: If there are more or fewer of them.
    """
    if classes is None:
        return np.broadcast_to(np.uint8(most), count)
    if np.shape(classes) != (count,):
        raise InvalidValueError(f"{np.shape(classes)} classes of precision for {count} Gaussians")
    levels = large_empty((count,), np.uint8)
    for level, some in zip(runs(levels), runs(np.asarray(classes)), strict=True):
        level[:] = np.clip(some, -most, 0) + most
    return levels


def _levels_of_flat(splats: Splats, levels: np.ndarray, most: int, bases: np.ndarray, size_log: int) -> np.ndarray:
    """Classes as they are sent, finer where the step of the smallest scale would make flat Gaussians thick.

    Multiples of a coarse step end well before the thinnest shape that a stream holds: at `1 << _FLAT_SHIFT` the
    smallest scale is at most 0.4 % of the next one, at 11 bits it is up to 31 %.

    Args:
        splats: The Gaussians.
        levels: uint8 (N), see `levels_of`.
        most: The finest class.
        bases: Exponents of steps.
        size_log: log2 of the scene's size.
    """
    flat = np.concatenate([np.flatnonzero(_is_flat(some)) + n * ROWS for n, some in enumerate(runs(splats.scales))])
    if not len(flat):
        return levels
    logs = to_logs(splats.select(flat), size_log) / (1 << BITS)
    opacity, s0, long = logs[:, 0], logs[:, 1], logs[:, 1] - logs[:, 2]
    known = np.stack([2 * s0 - long, long, np.zeros(len(flat)), opacity])
    exponents = (COEFFICIENTS[S_SCALE2] @ known + bases[S_SCALE2]) / (1 << STEP_BITS)
    # An exponent is rounded, and made of numbers that are rounded before.
    least = np.ceil(BITS - _FLAT_SHIFT - 0.25 - exponents)
    raised = levels.copy()
    raised[flat] = np.maximum(levels[flat], np.clip(least, 0, most)).astype(np.uint8)
    return raised


def _is_flat(scales: np.ndarray) -> np.ndarray:
    """Mask of Gaussians that are flatter than a stream holds, bool (N)."""
    low, middle, _ = rising(scales)
    return low < middle * np.float32(2.0**-MAX_THINNESS)


def _bases(splats: Splats, quality: Quality, size_log: int) -> np.ndarray:
    """Exponents of steps; that of the largest scale is as fine as its mean over the scene asks for."""
    bases = quality.bases(splats.degree)
    parts = list(runs(splats.scales))
    least = np.float32(2.0 ** (size_log - SMALLEST))

    def sizes(some: np.ndarray) -> tuple[float, int]:
        largest = some.max(axis=1)
        largest = largest[largest > least].astype(np.float64)
        return float(np.log2(largest).sum()), len(largest)

    totals = share(sizes, parts)
    # One after another: `sum` rounds in another way from Python 3.12 on.
    total = functools.reduce(operator.add, (logs for logs, _ in totals), 0.0)
    count = sum(number for _, number in totals)
    mean = total / count - size_log if count else -SMALLEST
    bases[S_SCALE0] += np.rint(COEFFICIENTS[S_SCALE0, 0] * (2 * mean - 2)).astype(np.int64)
    return bases


def _centres(
    splats: Splats, levels: np.ndarray, bases: np.ndarray, size_log: int, unit: int, coarsest: int
) -> np.ndarray:
    """Where a decoder will have the Gaussians, float32 (N, 3): in the middle of cells that are as large as their steps.

    Raises:
        InvalidValueError: If one is too far away for the lattice.
    """
    from splatwire.codec.schemas.gaussians import _gaussian_kernels as kernels

    centres, thinness = large_empty((splats.num_gaussians, 3), np.float32), thinness_table()

    def find(begin: int) -> None:
        some = centres[begin : begin + ROWS]
        part, shifts = splats.run(begin, begin + len(some)), np.empty(len(some), np.int64)
        classes = levels[begin : begin + len(some)].astype(np.int64)
        kernels.place_shifts(to_logs(part, size_log), classes, bases, unit, coarsest, thinness, shifts)
        some[:] = part.means
        # Twice: the middle of a cell as small as what a float32 tells apart is rounded, perhaps into the cell beside.
        for _ in range(2):
            cells = to_lattice(some.astype(np.float64), unit, size_log) >> shifts[:, None]
            half_units = ((2 * cells + 1) << shifts[:, None]).astype(np.float64)
            some[:] = np.ldexp(half_units, size_log - unit - 1)

    share(find, range(0, len(centres), ROWS))
    return centres


def _lattice_unit(splats: Splats, levels: np.ndarray, bases: np.ndarray, size_log: int) -> int:
    """A lattice as fine as the finest step of a place."""
    c, octaves = COEFFICIENTS[S_POSITION] / (1 << STEP_BITS), bases[S_POSITION] / (1 << STEP_BITS)

    def finest(some: tuple[np.ndarray, np.ndarray]) -> float:
        scales, level = (values.astype(np.float64) for values in some)
        _, middle, largest = (logs - size_log for logs in rising(np.log2(scales)))
        steps = octaves + level + c[0] * (largest + middle) + c[1] * (largest - middle)
        return float(np.maximum(steps, 1 - middle).max())

    most = max(share(finest, list(zip(runs(splats.scales), runs(levels), strict=True))), default=-np.inf)
    far = np.log2(float(np.abs(splats.means).max()) + 1e-30) - size_log
    return int(np.clip(np.ceil(most), 0, max(min(ROOM - np.ceil(far), ROOM), 0)))
