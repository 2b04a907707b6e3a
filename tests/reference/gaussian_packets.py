"""Decoding of one packet in plain Python: slow, and written so that it can be checked by eye against docs/format.md."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from reference.gaussian_bits import ReferenceBits
from reference.range_coder import ReferenceMixture, decode_mixture
from splatwire.codec.gaussians.layout import (
    BITS,
    COEFFICIENTS,
    DIRECTION_BITS,
    FIRST_CLASS,
    FIRST_HARMONIC,
    FIRST_MAGNITUDE,
    MAX_CELL_BITS,
    MAX_CLASSES,
    MAX_COLOUR,
    MAX_COMPANDED,
    MAX_HARMONIC,
    MAX_LOG,
    MAX_LOG_OPACITY,
    MAX_RESIDUAL,
    MAX_SQUARED_DISTANCE,
    MIN_LOG_OPACITY,
    NARROW_WEIGHT,
    NUM_MAGNITUDE_CONTEXTS,
    NUM_NEIGHBOURS,
    SLOT_BITS,
    STEP_BITS,
    STEP_COLOUR,
    STEP_DIRECTION,
    STEP_ELONGATION,
    STEP_FLATNESS,
    STEP_HARMONICS,
    STEP_OPACITY,
    STEP_POSITION,
    STEP_SCALE0,
    STEP_SPIN,
    WIDE_SCALE_OFFSET,
    WINDOW,
)
from splatwire.codec.gaussians.side_info import SideInfo
from splatwire.codec.gaussians.tables import flatness_table
from splatwire.entropy.tables import MEAN_BITS, NUM_SCALES

ONE = 1 << DIRECTION_BITS
RUNNING = (2, 6, 13, 24, 42, 74, 135)


@dataclass
class Gaussian:
    """A decoded Gaussian; fields as the columns of `layout`."""

    place: tuple[int, int, int] = (0, 0, 0)
    level: int = 0
    logs: list[int] = field(default_factory=list)
    axis: list[int] = field(default_factory=list)
    primary: int = 0
    spin: tuple[int, int] = (0, 0)
    colour: list[int] = field(default_factory=list)
    harmonics: list[int] = field(default_factory=list)

    def row(self) -> list[int]:
        """The columns in order."""
        return [*self.place, self.level, *self.logs, *self.axis, self.primary, *self.spin, *self.colour]


class ReferencePacket(ReferenceBits):
    """Decodes one packet.

    Args:
        info: Side information.
        block: Block of the packet.
        payload: Its payload.
        count: Number of Gaussians in the packet.
    """

    def __init__(self, info: SideInfo, block: int, payload: bytes, count: int) -> None:
        super().__init__(payload, [int(z) << 8 for z in info.zero_probabilities])
        self.info, self.count = info, count
        self.running = self.shift = 0
        self.absolute = info.max_position_shift >= 0
        self.box_bits = int(info.boxes.bits[block])
        self.block_means = [int(v) for v in info.block_means[block]]
        self.flatness_table = flatness_table().tolist()

    def decode(self) -> list[Gaussian]:
        """All Gaussians in order."""
        at = min(max(self.raw(6), self.box_bits - MAX_CELL_BITS), self.box_bits)
        depth = self.box_bits - at
        codes = self.codes(3 * depth)
        cells = [tuple(sum((c >> (3 * b + a) & 1) << b for b in range(depth)) for a in range(3)) for c in codes]
        found: list[Gaussian] = []
        for i, cell in enumerate(cells):
            near = sorted(
                (min(sum((p - q) ** 2 for p, q in zip(cell, cells[j], strict=True)), MAX_SQUARED_DISTANCE), i - j)
                for j in range(max(i - WINDOW, 0), i)
            )[:NUM_NEIGHBOURS]
            neighbours = [(found[i - back], ((near[0][0] + 1) << 12) // (d + 1)) for d, back in near]
            found.append(self.gaussian(cell, at, neighbours))
        return found

    def codes(self, bits: int) -> list[int]:
        """Morton codes of all cells: a sorted tree, and of spread packets slots one after another."""
        spread = self.raw(1)
        size = min(bits, SLOT_BITS) if spread else 0
        first, count = self.raw(size), self.raw(size) + 1
        upper = self.split(self.count, bits - size - 1, 0, 0)
        if not spread:
            return upper
        slots = [(first + self.below(count)) % 2**size for _ in upper]
        reverse = [sum((slot >> b & 1) << (size - 1 - b) for b in range(size)) for slot in slots]
        return [u << size | r for u, r in zip(upper, reverse, strict=True)]

    def gaussian(self, cell: tuple[int, ...], at: int, near: list[tuple[Gaussian, int]]) -> Gaussian:
        """One Gaussian, given its cell and its neighbours."""
        g = Gaussian()
        g.level, self.running = self.level(near), 16
        opacity = self.value(0, STEP_OPACITY, near, g.level, lambda n: n.logs[0], (0, 0, 0, 0), 0, BITS)
        opacity = min(max(opacity, MIN_LOG_OPACITY), MAX_LOG_OPACITY)
        mean = self.mean(near, lambda n: n.logs[1], self.block_means[1])[0]
        shape = (0 if self.absolute else 2 * mean - (2 << BITS), 0, 0, opacity)
        s0 = self.value(1, STEP_SCALE0, near, g.level, lambda n: n.logs[1], shape, 1, BITS - 1)
        s0 = min(max(s0, -MAX_LOG), MAX_LOG)
        shape = (2 * s0 - (2 << BITS), 0, 0, opacity)
        elongation = self.value(2, STEP_ELONGATION, near, g.level, lambda n: n.logs[2], shape, 2, BITS - 1)
        elongation = min(max(elongation, 0), MAX_LOG)
        shape = (2 * s0 - elongation, elongation, 0, opacity)
        companded = self.value(3, STEP_FLATNESS, near, g.level, lambda n: n.logs[3], shape, 3, BITS - 1)
        companded = min(
            max(companded, 0), (MAX_COMPANDED >> self.shift) << self.shift if self.absolute else MAX_COMPANDED
        )
        g.logs, flatness = [opacity, s0, elongation, companded], self.flatness_table[companded]
        shape = (2 * s0 - elongation, elongation, flatness, opacity)
        finest = max(self.exponent(STEP_POSITION, g.level, shape), 1 - ((s0 - elongation) >> BITS))
        size = min(
            max(self.info.lattice_bits - finest, 0), self.info.max_position_shift if self.absolute else self.box_bits
        )
        low = min(at, size)
        fine = [(c << (at - low)) | self.raw(at - low) for c in cell]
        size = size if self.absolute else low
        x, y, z = ((c >> (size - low)) * 2 ** (size + 1) + 2**size for c in fine)
        g.place, g.primary = (x, y, z), 2 if flatness >= elongation else 0
        shift = min(max(DIRECTION_BITS - self.exponent(STEP_DIRECTION, g.level, shape), 0), DIRECTION_BITS - 2)
        g.axis = self.axis(near, g.primary, shift)
        bits = min(max(self.exponent(STEP_SPIN, g.level, shape), 0), DIRECTION_BITS)
        g.spin = bits, self.raw(bits)
        self.colour(g, near)
        if self.info.num_harmonic_columns:
            self.harmonics(g)
        return g

    def value(
        self, kind: int, step: np.integer[Any], near: list[tuple[Gaussian, int]], level: int,
        of: Callable[[Gaussian], int], shape: tuple[int, int, int, int], default: int, most: int,
    ) -> int:  # fmt: skip
        """Decodes a value that is predicted by the mean of its neighbours."""
        mean, deviation = self.mean(near, of, self.block_means[default])
        shift = min(max(BITS - self.exponent(step, level, shape), 0), most)
        return self.coded(kind, spread(len(near), deviation, shift), mean, shift)

    def coded(self, kind: int, context: int, mean: int, shift: int) -> int:
        """Decodes a value with the expectation `mean`, as a multiple of the step or as whole steps from the mean."""
        self.shift = shift
        if not self.absolute:
            return mean + (self.residual(kind, context, shift, 0) << shift)
        eighths = (8 * mean + ((1 << shift) >> 1)) >> shift
        near = (eighths + 4) >> 3
        return (near + self.residual(kind, context, shift, eighths - 8 * near)) << shift

    def axis(self, near: list[tuple[Gaussian, int]], primary: int, shift: int) -> list[int]:
        """Decodes the primary axis of the Gaussian."""
        same = [(n.axis, w) for n, w in near if n.primary == primary]
        mean, deviation = [0, 0, ONE], 0
        if same:
            ours = [w if sum(p * q for p, q in zip(u, same[0][0], strict=True)) >= 0 else -w for u, w in same]
            sums = [sum(w * u[a] for (u, _), w in zip(same, ours, strict=True)) for a in range(3)]
            if any(sums):
                mean, total = sums, sum(w for _, w in same)
                middle = [s // total for s in sums]
                sides = [
                    min(sum(abs(p - s * q) for p, q in zip(u, middle, strict=True)) for s in (1, -1)) for u, _ in same
                ]
                deviation = sum(w * d for (_, w), d in zip(same, sides, strict=True)) // total
            else:
                same = []
        pole = max(range(3), key=lambda a: abs(mean[a]))
        mean = [-m for m in mean] if mean[pole] < 0 else mean
        first, second, norm = (pole + 1) % 3, (pole + 2) % 3, sum(map(abs, mean))
        context = spread(len(same), deviation, shift)
        axis, square = [0, 0, 0], []
        if self.absolute:
            for a, expected in ((first, mean[first]), (second, mean[second])):
                most = ONE - sum(map(abs, axis))
                value = self.coded(4, context, (expected << DIRECTION_BITS) // norm, shift)
                axis[a] = min(max(value, -most), most)
            axis[pole] = ONE - sum(map(abs, axis))
            largest = max(axis, key=abs)
            return [-a for a in axis] if largest < 0 else axis
        for sign in (1, -1):
            expected = ((mean[first] + sign * mean[second]) << DIRECTION_BITS) // norm
            square.append(min(max(self.coded(4, context, expected, shift), -ONE), ONE))
        axis[first], axis[second] = (square[0] + square[1]) >> 1, (square[0] - square[1]) >> 1
        axis[pole] = max(ONE - abs(axis[first]) - abs(axis[second]), 0)
        return axis

    def colour(self, g: Gaussian, near: list[tuple[Gaussian, int]]) -> None:
        """Decodes luma and chroma."""
        shift = min(max(BITS - self.exponent(STEP_COLOUR, g.level, (0, 0, 0, 0)), 0), BITS - 2)
        for c in range(3):
            mean, deviation = self.mean(near, lambda n, c=c: n.colour[c], self.block_means[4 + c])  # type: ignore[misc]
            value = self.coded(5 + c, spread(len(near), deviation, shift), mean, shift)
            g.colour.append(min(max(value, -MAX_COLOUR), MAX_COLOUR))

    def harmonics(self, g: Gaussian) -> None:
        """Harmonics, the three channels of one coefficient after another."""
        shift = min(max(BITS - self.exponent(STEP_HARMONICS, g.level, (0, 0, 0, 0)), 0), BITS - 2)
        some, running = self.bit(FIRST_HARMONIC + g.level), 0
        for j in range(self.info.num_harmonic_columns):
            value = 0
            if some:
                context = sum(running >= least for least in RUNNING)
                group = (j >= 3) + (j >= 9) + (j >= 21)
                value = self.coefficient(context, (context * 4 + group) * 2 + (j % 3 > 0))
            g.harmonics.append(min(max(value << shift, -MAX_HARMONIC), MAX_HARMONIC))
            running = (running * 13 >> 4) + (min(abs(value), 1 << 16) << 4)

    def coefficient(self, context: int, zero: int) -> int:
        """Decodes one harmonics coefficient, in quantisation steps."""
        if not self.bit(FIRST_HARMONIC + MAX_CLASSES + zero):
            return 0
        sign, size = (-1 if self.raw(1) else 1), 1
        while size < 15 and self.bit(FIRST_MAGNITUDE + context * 3 + min(size - 1, 2)):
            size += 1
        if size == 15:
            size += min(self.gamma(), 1 << 20)
        return sign * size

    def level(self, near: list[tuple[Gaussian, int]]) -> int:
        """Decodes the precision class."""
        total = sum(w for _, w in near)
        context = 1 + (4 * sum(n.level * w for n, w in near) + total) // (2 * total) if near else 0
        node = 1
        for _ in range(3):
            node = 2 * node + self.bit(FIRST_CLASS + 8 * context + node)
        return node - 8

    def split(self, n: int, bit: int, run: int, prefix: int) -> list[int]:
        """Sorted codes of a node of n Gaussians that agree in all bits above `bit`."""
        if n == 0 or bit < 0 or n == 1:
            return [prefix << (bit + 1) | (self.raw(bit + 1) if n and bit >= 0 else 0)] * n
        together = self.bit(4 * (min(n.bit_length() - 1, 8) - 1) + run)
        zeros = n * self.raw(1) if together else 1 + self.below(n - 1)
        run = min(run + 1, 3) if together else 0
        return self.split(zeros, bit - 1, run, 2 * prefix) + self.split(n - zeros, bit - 1, run, 2 * prefix + 1)

    def mean(self, near: list[tuple[Gaussian, int]], of: Callable[[Gaussian], int], default: int) -> tuple[int, int]:
        """Weighted mean of the neighbours, and their weighted mean deviation from it."""
        total = sum(w for _, w in near)
        if not near:
            return default, 0
        mean = sum(of(n) * w for n, w in near) // total
        return mean, sum(abs(of(n) - mean) * w for n, w in near) // total

    def exponent(self, which: np.integer[Any], level: int, shape: tuple[int, int, int, int]) -> int:
        """`-log2` of the quantisation step of an attribute."""
        sums = sum(int(c) * x for c, x in zip(COEFFICIENTS[which], shape, strict=True))
        sums += (int(self.info.base_exponents[which]) + level * 2**STEP_BITS) * 2**BITS
        return (sums + 2 ** (BITS + STEP_BITS - 1)) >> (BITS + STEP_BITS)

    def residual(self, kind: int, context: int, shift: int, eighths: int) -> int:
        """A residual in steps; its context, except for the first two, is the size of earlier residuals."""
        second = shift if kind < 2 else min(self.running.bit_length(), NUM_MAGNITUDE_CONTEXTS - 1)
        scale = int(self.info.scale_indices[kind, context, second])
        mean = eighths << (MEAN_BITS - 3)
        mixture = ReferenceMixture(mean, scale, mean, min(scale + WIDE_SCALE_OFFSET, NUM_SCALES - 1), NARROW_WEIGHT)
        q = min(max(decode_mixture(self.coder, mixture), -MAX_RESIDUAL), MAX_RESIDUAL)
        self.running = (self.running + 16 * min(abs(q), 1 << 14)) >> 1
        return q


def spread(count: int, deviation: int, shift: int) -> int:
    """Context of a residual: without neighbours, with fewer than three, or by their deviation in octaves."""
    return min(count, 1) if count < 3 else 2 + min((deviation * 8 >> shift).bit_length(), 9)
