"""Chooses the anchors that get a coarse copy, and the precision of each copy, by rate-distortion optimisation."""

# The distortion is the error in rendered pictures, estimated to first order from the sensitivity of the pictures.

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from splatwire.arguments import CheckedFields
from splatwire.concealment.sketch.concealer import MAX_LOG_SIZE, expected_scalings
from splatwire.concealment.sketch.section import MAX_DIRECTION, OFFSET_STEPS, SketchBasis, SketchSection
from splatwire.ops.arrays import to_arrays
from splatwire.render.sensitivity import Sensitivity
from splatwire.types import AnchorScene, PredictedPositions, Prior, ReceivedScene

BITS_OF_COPY = 60
"""Approximate minimum size of the copy of an anchor, bits."""
_CANDIDATES, _MAX_CANDIDATES = 4, 0.3
"""Number of candidate anchors per copy that fits into the sketch; their maximum number as a share of all anchors."""
_BASIS_SHARE = 0.05
"""Share of the anchors, most important first, from which the basis for coding channels is computed.

It is about the share of anchors that will be copied.
"""
_ROUNDS = 4
_MAGNITUDES = 16
_ROUND_UP = 0.42
"""Value added to magnitudes before rounding down. It is below 0.5, because the bits saved outweigh the larger rounding
error.
"""


@dataclass(frozen=True)
class SketchFit(CheckedFields):
    """Settings for choosing the anchors that get a coarse copy, and the precision of the copies.

    Attributes:
        num_levels: Number of precision levels of copies; the quantisation step halves from each level to the next.
        max_columns: Maximum number of basis vectors (transform coefficients) for coding features and scalings.
        removal_error_factor: Factor on the picture error that is estimated for the loss of an anchor. A smaller factor
            gives fewer copies.
        exponent: Exponent that controls how much received anchors are enlarged to cover lost neighbours
            (`Grow.exponent`).
        max_excess: Upper limit of the enlargement, as a multiple of the enlargement that follows from the lost share of
            the whole scene (`Grow.max_excess`).
        trust: Weight of the neural network that corrects the enlargement, 0 (no correction) to 1 (`SceneFree.trust`).
    """

    num_levels: int = 4
    max_columns: int = 40
    removal_error_factor: float = 0.6
    exponent: float = 0.2
    max_excess: float = 1.08
    trust: float = 0.0


@dataclass(frozen=True, eq=False)
class SketchMaterial:
    """Data for choosing the anchors that get a coarse copy in the side information, and the precision of each copy.

    Only M of the scene's N anchors may get a copy. These anchors are called candidates. A cost is a squared error in
    rendered pictures.

    Attributes:
        candidates: Indices of the candidates in the scene, ascending, int64 (M).
        channels: D channels of each candidate, float64 (M, D): its features, then the logarithms of its scalings
            divided by the scalings that a receiver predicts for a lost anchor.
        mean: Mean of each channel over the most important anchors, float64 (D).
        forward: Matrix that transforms the channels to D uncorrelated coefficients, sorted by descending variance,
            float64 (D, D).
        backward: Inverse of `forward`, float64 (D, D).
        spread: Standard deviation of each coefficient, float64 (D).
        weight: For each candidate, cost of an error of 1 in any one of its coefficients, float64 (M).
        offset_weight: For each candidate and offset, cost of an error of 1 in one coordinate, float64 (M, K).
        removal: For each candidate, cost if it is lost and has no copy, float64 (M).
        offset_removal: For each candidate and offset, cost if only the Gaussian of this offset is lost, float64 (M, K).
        offsets: K offsets of each candidate, float64 (M, 3 K). Offsets are relative to the position at which a receiver
            draws the copy. Their unit is the candidate's first three scalings.
        mask: Mask of the offsets that exist, bool (M, K).
        num_anchors: Number of anchors of the scene, N.
    """

    # An error of 1 has the same cost in each coefficient.

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
        """Returns the value of the argument `price` of `fit_sketch` with which about `count` anchors get a copy.

        The price of a bit is a squared error in the pictures. An anchor gets a copy if `removal_error_factor` times the
        error caused by its loss exceeds the price of the copy's bits.

        Args:
            count: Number of anchors to copy.
            options: Settings for choosing the anchors that get a copy.
        """
        # The number of bits of a copy is estimated by a constant.
        ranked = np.sort(self.removal)[::-1]
        return max(
            options.removal_error_factor * float(ranked[min(round(count), len(ranked) - 1)]) / BITS_OF_COPY, 2.0**-40
        )


def num_candidates(max_bytes: int) -> int:
    """Returns how many of the most important anchors may get a coarse copy in the side information.

    Args:
        max_bytes: Maximum size of all copies in bytes.
    """
    return _CANDIDATES * 8 * max_bytes // BITS_OF_COPY


def sketch_material(complete: ReceivedScene[AnchorScene], sensitivity: Sensitivity, max_bytes: int) -> SketchMaterial:
    """Prepares the data for choosing the anchors of the sketch, which get a coarse copy.

    Args:
        complete: The complete scene.
        sensitivity: Errors of the rendered pictures if attributes of an anchor change, or if the anchor is lost.
        max_bytes: Maximum size of the sketch in bytes.
    """
    anchors, sensitivities = to_arrays(complete.scene.anchors), dict[str, np.ndarray](vars(to_arrays(sensitivity)))
    removal = sensitivities["removal"]
    num = len(removal)
    order = np.argsort(-removal, kind="stable")
    important = order[: max(round(_BASIS_SHARE * num), min(num, 64))]
    candidates = np.sort(order[: max(min(num_candidates(max_bytes), round(_MAX_CANDIDATES * num)), 1)])
    relative = np.log(np.maximum(anchors.scalings, np.float32(1e-9)) / expected_scalings(complete[Prior]))
    relative = np.clip(relative, -MAX_LOG_SIZE, MAX_LOG_SIZE)
    channels = np.concatenate([anchors.features, relative], axis=1).astype(np.float64)
    metric = sensitivities["metric"] / num
    metric = metric + np.eye(len(metric)) * max(np.trace(metric) / len(metric) * 1e-4, 1e-30)
    eigenvalues, vectors = np.linalg.eigh(metric)
    whiten, color = np.sqrt(eigenvalues)[:, None] * vectors.T, vectors / np.sqrt(eigenvalues)
    mean = channels[important].mean(axis=0)
    covariance = np.atleast_2d(np.cov((channels[important] - mean) @ whiten.T, rowvar=False))
    variances, axes = np.linalg.eigh(covariance)
    variances, axes = variances[::-1], axes[:, ::-1]
    detail = sensitivities["channels"][candidates]
    return SketchMaterial(
        candidates, channels[candidates], mean, axes.T @ whiten, color @ axes, np.sqrt(np.maximum(variances, 0)),
        np.maximum((detail / np.diag(metric)).mean(axis=1), 1e-12), sensitivities["offsets"][candidates],
        removal[candidates], sensitivities["offset_removal"][candidates],
        _offsets_of_copies(complete)[candidates], anchors.mask[candidates], num,
    )  # fmt: skip


def _offsets_of_copies(complete: ReceivedScene[AnchorScene]) -> Float[np.ndarray, "N O"]:
    """Returns the offsets that a coarse copy of each anchor would contain.

    Offsets are relative to the position at which a receiver draws the copy of a lost anchor.

    Args:
        complete: The complete scene.

    Returns:
        K offsets of each of the N anchors, in units of the first three scalings of the anchor, float64 (N, 3 K).
    """
    # In streams whose packets contain the exact positions of anchors, a receiver draws the copy of a lost anchor at
    # a predicted position (`PredictedPositions`). The offsets are then relative to this position.
    anchors, predicted = to_arrays(complete.scene.anchors), complete.get(PredictedPositions)
    offsets, rows = anchors.offsets.astype(np.float64), anchors.num_anchors
    if predicted is None:
        return offsets.reshape(rows, -1)
    sizes = np.maximum(anchors.scalings[:, :3].astype(np.float64), 1e-9)
    moved = (anchors.positions - predicted.positions).astype(np.float64) / sizes
    return (offsets + moved[:, None] * anchors.mask[:, :, None]).reshape(rows, -1)


def fit_sketch(material: SketchMaterial, price: float, options: SketchFit) -> SketchSection:
    """Chooses which anchors get a coarse copy, and how precise each copy is; returns the quantised copies.

    The choice minimises the squared error in the pictures plus `price` times the number of bits.

    Args:
        material: Data of the scene and of the anchors that may be copied.
        price: Squared error that a bit must save (Lagrange multiplier).
        options: Settings for the choice and quantisation.
    """
    basis, step = _basis(material, price, options)
    plans = [_Plan.of(material, basis, step, level, price, options) for level in range(1, options.num_levels + 1)]
    chosen = np.zeros(len(material.candidates), dtype=np.int64)
    lost = options.removal_error_factor * material.removal
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
    """Chooses the transform and the quantisation steps for the coarse copies of anchors.

    Args:
        material: Data of the scene and of the anchors that may be copied.
        price: Squared error that a bit must save (Lagrange multiplier).
        options: Settings for the choice and quantisation.

    Returns:
        The quantised transform, which includes the quantisation step of offsets; and the quantisation step of the
        coefficients at the coarsest precision level.
    """
    # For a small step s and a weight w, the error is `w s^2 / 12`, and one more bit reduces the error to a quarter.
    likely = options.removal_error_factor * material.removal > price * BITS_OF_COPY
    weight = np.quantile(material.weight[likely], 0.1) if likely.any() else material.weight.max()
    ideal = 6 / math.log(2) * price
    step = math.sqrt(ideal / weight)
    exists = material.mask & likely[:, None] if likely.any() else material.mask
    seen = material.offset_weight[exists & (material.offset_weight > 0)]
    offset_weight = np.quantile(seen, 0.1) if len(seen) else 1.0
    finest = step * 0.5 ** (options.num_levels - 1)
    columns = int(np.clip((material.spread > 0.7 * finest).sum(), 1, options.max_columns))
    directions = material.backward[:, :columns] * step
    # a basis vector whose coefficients are small integers needs less precision
    precise = np.clip(material.spread[:columns] / finest, 10, MAX_DIRECTION)
    scales = (np.abs(directions).max(axis=0) / precise).astype(np.float16).astype(np.float32)
    integers = np.rint(directions / np.maximum(scales, np.float32(1e-7)))
    integers = np.clip(integers, -MAX_DIRECTION, MAX_DIRECTION).astype(np.int16)
    mean = material.mean.astype(np.float16).astype(np.float32)
    offset_step = float(np.clip(np.float32(math.sqrt(ideal / offset_weight)), *OFFSET_STEPS))
    return SketchBasis(mean, integers, scales, offset_step, options.num_levels), step


@dataclass(frozen=True, eq=False)
class _Plan:
    """Coarse copies of all M candidates (anchors that may get a copy), quantised at one precision level.

    Attributes:
        mask: Mask of the Gaussians that each copy contains, bool (M, K).
        values: Quantised coefficients of features and scalings, int64 (M, C).
        offsets: Quantised offsets of the Gaussians, int64 (M, 3 K).
        error: Squared error in the pictures if the copy is drawn in place of the anchor, float64 (M).
    """

    # Offsets are 0 for Gaussians that are not in the mask; errors are infinite for a copy without Gaussians.

    mask: np.ndarray
    values: np.ndarray
    offsets: np.ndarray
    error: np.ndarray

    @staticmethod
    def of(
        material: SketchMaterial,
        basis: SketchBasis,
        step: float,
        precision_level: int,
        price: float,
        options: SketchFit,
    ) -> "_Plan":
        columns, half = basis.directions.shape[1], 0.5 ** (precision_level - 1)
        target = (material.channels - material.mean) @ material.forward.T
        values = _rounded(target[:, :columns] / (step * half))
        left = (target[:, columns:] ** 2).sum(axis=1)
        left = left + ((target[:, :columns] - values * step * half) ** 2).sum(axis=1)
        unit = basis.offset_step * half
        offsets = _rounded(material.offsets / unit)
        wrong = ((material.offsets - offsets * unit) ** 2).reshape(*material.mask.shape, 3).sum(axis=2)
        wrong = wrong * material.offset_weight
        size = 3 + 2 * np.log2(1 + np.abs(offsets)).reshape(*material.mask.shape, 3).sum(axis=2)
        gone = options.removal_error_factor * material.offset_removal
        mask = material.mask & (wrong + price * size < gone)
        error = material.weight * left + np.where(mask, wrong, np.where(material.mask, gone, 0)).sum(axis=1)
        error = np.where(mask.any(axis=1), error, np.inf)
        return _Plan(mask, values, offsets * np.repeat(mask, 3, axis=1), error)

    def bits(self, copied: np.ndarray) -> np.ndarray:
        """Estimates the size of each candidate's copy at the precision level of this plan, bits, float64 (M).

        Args:
            copied: Mask of the candidates that are likely to get a copy, bool (M). Symbol frequencies are counted in
                the copies of these candidates, or in all copies if the mask has fewer than 16 candidates.
        """
        used = copied if copied.sum() >= 16 else np.ones_like(copied)
        total = np.full(len(copied), 6.0)
        for c in range(self.values.shape[1]):
            total += _ideal_bits(self.values[:, c], self.values[used, c])
        exists = np.repeat(self.mask, 3, axis=1)
        bits = _ideal_bits(self.offsets.ravel(), self.offsets[used][exists[used]]).reshape(self.offsets.shape)
        total += (bits * exists).sum(axis=1)
        share = np.clip(self.mask[used].mean(axis=0), 0.02, 0.98)
        return total - np.where(self.mask, np.log2(share), np.log2(1 - share)).sum(axis=1)


def _rounded(values: np.ndarray) -> np.ndarray:
    return (np.sign(values) * np.floor(np.abs(values) + _ROUND_UP)).astype(np.int64)


def _ideal_bits(values: np.ndarray, sample: np.ndarray) -> np.ndarray:
    """Returns the ideal code length of integers in bits, given the symbol frequencies of a sample.

    Args:
        values: Integers to code.
        sample: Integers whose frequencies are counted.
    """
    # Large magnitudes use an escape code.
    counts = np.bincount(np.minimum(np.abs(sample), _MAGNITUDES), minlength=_MAGNITUDES + 1) + 0.3
    magnitude = np.abs(values)
    bits = -np.log2(counts / counts.sum())[np.minimum(magnitude, _MAGNITUDES)] + (magnitude > 0)
    return bits + np.where(magnitude >= _MAGNITUDES, 2 * np.log2(np.maximum(magnitude - _MAGNITUDES + 1, 1)) + 1, 0)
