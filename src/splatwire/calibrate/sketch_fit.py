"""Which anchors a sketch holds, and how coarsely: a rate-distortion choice by what errors cost in the picture."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from splatwire.conceal.sketch.concealer import MAX_LOG_SIZE, expected_scalings
from splatwire.conceal.sketch.section import MAX_DIRECTION, OFFSET_STEPS, SketchBasis, SketchSection
from splatwire.model import AnchorScene, ExpectedPlaces, Partial, Prior
from splatwire.ops.arrays import to_arrays
from splatwire.render.sensitivity import Sensitivity

BITS_OF_COPY = 60
"""About what a sketched anchor takes, at least."""
_CANDIDATES, _MOST_CANDIDATES = 4, 0.3
"""Anchors that are looked at: four times as many as could be sketched, and at most this share of them."""
_BASIS_SHARE = 0.05
"""The basis is that of the most important anchors: about as many as will be sketched."""
_ROUNDS = 4
_MAGNITUDES = 16
_ROUND_UP = 0.42
"""Numbers are rounded up from `1 - _ROUND_UP` on: zero and small integers are cheaper than they are wrong."""


@dataclass(frozen=True)
class SketchFit:
    """How a sketch is made.

    Attributes:
        num_levels: Step sizes, each half of the one before.
        max_columns: Most columns of the basis.
        crowding: What the loss of an anchor counts relative to errors of its copy, of which the cost is only known to
            first order.
        exponent: Of the growth.
        max_excess: Limit of the growth.
        trust: In the network that corrects the growth.
    """

    num_levels: int = 4
    max_columns: int = 40
    crowding: float = 0.6
    exponent: float = 0.2
    max_excess: float = 1.08
    trust: float = 0.0


@dataclass(frozen=True, eq=False)
class SketchMaterial:
    """What does not depend on the rate.

    Attributes:
        candidates: int64 (M), anchors that may be sketched, ascending.
        channels: float64 (M, D), features and logarithms of scalings.
        mean: float64 (D).
        forward: float64 (D, D), to coordinates in which an error of 1 costs `weight`, largest variance first.
        backward: Its inverse.
        spread: float64 (D), standard deviation of each coordinate.
        weight: float64 (M), cost of a squared error of 1.
        offset_weight: float64 (M, K), of each coordinate of an offset.
        removal: float64 (M), cost of leaving an anchor out.
        offset_removal: float64 (M, K), of one of its Gaussians.
        offsets: float64 (M, 3 K), from where a receiver has a lost anchor.
        mask: bool (M, K).
        num_anchors: N.
    """

    candidates: np.ndarray
    channels: np.ndarray
    mean: np.ndarray
    forward: np.ndarray
    backward: np.ndarray
    spread: np.ndarray
    weight: np.ndarray
    offset_weight: np.ndarray
    removal: np.ndarray
    offset_removal: np.ndarray
    offsets: np.ndarray
    mask: np.ndarray
    num_anchors: int

    def price_of(self, count: float, options: SketchFit) -> float:
        """About the price at which so many anchors are sketched: where leaving the last of them out costs as much."""
        ranked = np.sort(self.removal)[::-1]
        return max(options.crowding * float(ranked[min(round(count), len(ranked) - 1)]) / BITS_OF_COPY, 2.0**-40)


def num_candidates(most: int) -> int:
    """Anchors that a sketch of so many bytes is chosen from."""
    return _CANDIDATES * 8 * most // BITS_OF_COPY


def sketch_material(complete: Partial[AnchorScene], sensitivity: Sensitivity, most: int) -> SketchMaterial:
    """Prepares a complete scene for sketches of at most so many bytes."""
    anchors, found = to_arrays(complete.scene.anchors), dict[str, np.ndarray](vars(to_arrays(sensitivity)))
    removal = found["removal"]
    num = len(removal)
    order = np.argsort(-removal, kind="stable")
    important = order[: max(round(_BASIS_SHARE * num), min(num, 64))]
    candidates = np.sort(order[: max(min(num_candidates(most), round(_MOST_CANDIDATES * num)), 1)])
    relative = np.log(np.maximum(anchors.scalings, np.float32(1e-9)) / expected_scalings(complete[Prior]))
    relative = np.clip(relative, -MAX_LOG_SIZE, MAX_LOG_SIZE)
    channels = np.concatenate([anchors.features, relative], axis=1).astype(np.float64)
    metric = found["metric"] / num
    metric = metric + np.eye(len(metric)) * max(np.trace(metric) / len(metric) * 1e-4, 1e-30)
    eigenvalues, vectors = np.linalg.eigh(metric)
    whiten, color = np.sqrt(eigenvalues)[:, None] * vectors.T, vectors / np.sqrt(eigenvalues)
    mean = channels[important].mean(axis=0)
    covariance = np.atleast_2d(np.cov((channels[important] - mean) @ whiten.T, rowvar=False))
    variances, axes = np.linalg.eigh(covariance)
    variances, axes = variances[::-1], axes[:, ::-1]
    detail = found["channels"][candidates]
    return SketchMaterial(
        candidates, channels[candidates], mean, axes.T @ whiten, color @ axes, np.sqrt(np.maximum(variances, 0)),
        np.maximum((detail / np.diag(metric)).mean(axis=1), 1e-12), found["offsets"][candidates],
        removal[candidates], found["offset_removal"][candidates],
        _offsets_of_copies(complete)[candidates], anchors.mask[candidates], num,
    )  # fmt: skip


def _offsets_of_copies(complete: Partial[AnchorScene]) -> Float[np.ndarray, "N O"]:
    """Offsets from where a receiver has a lost anchor, which its own packet would have told better."""
    anchors, guessed = to_arrays(complete.scene.anchors), complete.find(ExpectedPlaces)
    offsets, rows = anchors.offsets.astype(np.float64), anchors.num_anchors
    if guessed is None:
        return offsets.reshape(rows, -1)
    sizes = np.maximum(anchors.scalings[:, :3].astype(np.float64), 1e-9)
    moved = (anchors.positions - guessed.positions).astype(np.float64) / sizes
    return (offsets + moved[:, None] * anchors.mask[:, :, None]).reshape(rows, -1)


def fit_sketch(material: SketchMaterial, price: float, options: SketchFit) -> SketchSection:
    """Chooses level, mask and integers of every anchor so that error plus price times bits is least.

    Args:
        material: The scene.
        price: Squared error per bit.
        options: How.
    """
    basis, step = _basis(material, price, options)
    plans = [_Plan.of(material, basis, step, level, price, options) for level in range(1, options.num_levels + 1)]
    chosen = np.zeros(len(material.candidates), dtype=np.int64)
    lost = options.crowding * material.removal
    for _ in range(_ROUNDS):
        costs = np.stack([lost, *(plan.error + price * plan.bits(chosen == i + 1) for i, plan in enumerate(plans))])
        chosen = costs.argmin(axis=0)
    levels = np.zeros(material.num_anchors, dtype=np.int64)
    levels[material.candidates] = chosen
    rows = np.flatnonzero(chosen)
    mask, values, offsets = (
        np.stack([getattr(plan, name) for plan in plans])[chosen[rows] - 1, rows]
        for name in ("mask", "values", "offsets")
    )
    growth = (options.exponent, options.max_excess, options.trust)
    return SketchSection(*growth, basis, levels, mask.astype(np.uint8), values, offsets)


def _basis(material: SketchMaterial, price: float, options: SketchFit) -> tuple[SketchBasis, float]:
    """Steps at which a bit more costs what it saves: for a fine step s, error `w s^2 / 12` halves twice with a bit."""
    likely = options.crowding * material.removal > price * BITS_OF_COPY
    weight = np.quantile(material.weight[likely], 0.1) if likely.any() else material.weight.max()
    ideal = 6 / math.log(2) * price
    step = math.sqrt(ideal / weight)
    exists = material.mask & likely[:, None] if likely.any() else material.mask
    seen = material.offset_weight[exists & (material.offset_weight > 0)]
    offset_weight = np.quantile(seen, 0.1) if len(seen) else 1.0
    finest = step * 0.5 ** (options.num_levels - 1)
    columns = int(np.clip((material.spread > 0.7 * finest).sum(), 1, options.max_columns))
    directions = material.backward[:, :columns] * step
    # a column whose integers are small need not point as precisely
    precise = np.clip(material.spread[:columns] / finest, 10, MAX_DIRECTION)
    scales = (np.abs(directions).max(axis=0) / precise).astype(np.float16).astype(np.float32)
    integers = np.rint(directions / np.maximum(scales, np.float32(1e-7)))
    integers = np.clip(integers, -MAX_DIRECTION, MAX_DIRECTION).astype(np.int16)
    mean = material.mean.astype(np.float16).astype(np.float32)
    offset_step = float(np.clip(np.float32(math.sqrt(ideal / offset_weight)), *OFFSET_STEPS))
    return SketchBasis(mean, integers, scales, offset_step, options.num_levels), step


@dataclass(frozen=True, eq=False)
class _Plan:
    """All candidates at one level: integers, error, and what decides the bits."""

    mask: np.ndarray
    values: np.ndarray
    offsets: np.ndarray
    error: np.ndarray

    @staticmethod
    def of(
        material: SketchMaterial, basis: SketchBasis, step: float, level: int, price: float, options: SketchFit
    ) -> "_Plan":
        columns, half = basis.directions.shape[1], 0.5 ** (level - 1)
        target = (material.channels - material.mean) @ material.forward.T
        values = _rounded(target[:, :columns] / (step * half))
        left = (target[:, columns:] ** 2).sum(axis=1)
        left = left + ((target[:, :columns] - values * step * half) ** 2).sum(axis=1)
        unit = basis.offset_step * half
        offsets = _rounded(material.offsets / unit)
        wrong = ((material.offsets - offsets * unit) ** 2).reshape(*material.mask.shape, 3).sum(axis=2)
        wrong = wrong * material.offset_weight
        size = 3 + 2 * np.log2(1 + np.abs(offsets)).reshape(*material.mask.shape, 3).sum(axis=2)
        gone = options.crowding * material.offset_removal
        mask = material.mask & (wrong + price * size < gone)
        error = material.weight * left + np.where(mask, wrong, np.where(material.mask, gone, 0)).sum(axis=1)
        error = np.where(mask.any(axis=1), error, np.inf)
        return _Plan(mask, values, offsets * np.repeat(mask, 3, axis=1), error)

    def bits(self, members: np.ndarray) -> np.ndarray:
        """Bits of every candidate, as if coded with the frequencies of those that have this level now."""
        used = members if members.sum() >= 16 else np.ones_like(members)
        total = np.full(len(members), 6.0)
        for c in range(self.values.shape[1]):
            total += _ideal_bits(self.values[:, c], self.values[used, c])
        exists = np.repeat(self.mask, 3, axis=1)
        bits = _ideal_bits(self.offsets.ravel(), self.offsets[used][exists[used]]).reshape(self.offsets.shape)
        total += (bits * exists).sum(axis=1)
        share = np.clip(self.mask[used].mean(axis=0), 0.02, 0.98)
        return total - np.where(self.mask, np.log2(share), np.log2(1 - share)).sum(axis=1)


def _rounded(numbers: np.ndarray) -> np.ndarray:
    return (np.sign(numbers) * np.floor(np.abs(numbers) + _ROUND_UP)).astype(np.int64)


def _ideal_bits(values: np.ndarray, sample: np.ndarray) -> np.ndarray:
    """Bits of integers under the frequencies of the magnitudes in a sample; large ones are escaped."""
    counts = np.bincount(np.minimum(np.abs(sample), _MAGNITUDES), minlength=_MAGNITUDES + 1) + 0.3
    magnitude = np.abs(values)
    bits = -np.log2(counts / counts.sum())[np.minimum(magnitude, _MAGNITUDES)] + (magnitude > 0)
    return bits + np.where(magnitude >= _MAGNITUDES, 2 * np.log2(np.maximum(magnitude - _MAGNITUDES + 1, 1)) + 1, 0)
