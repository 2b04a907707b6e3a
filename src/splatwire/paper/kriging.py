"""Simple kriging: the conditional mean of a lost anchor given its received neighbours, under a fitted covariance."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Bool, Float, Float64, Int64
from torch import Tensor

from splatwire.arguments import check_fields
from splatwire.concealment.base import Concealed, check_at_least
from splatwire.concealment.registry import register_concealer
from splatwire.errors import InvalidValueError
from splatwire.neural.model.tensors import to_tensors
from splatwire.paper.fill import MaskVote, attributes_by_gap
from splatwire.paper.neighbors import TensorTree, nearest_other_points
from splatwire.types import Anchors, Attribute, Prior, ReceivedScene
from splatwire.types.prior import plausible_scalings

_CHUNK = 1 << 12
_CORRELATIONS = (0.2, 0.35, 0.5, 0.65, 0.8, 0.95)
_RANGES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
TARGETS = ("residual", "absolute", "regression")
_RIDGES = (1e-3, 1e-2, 1e-1, 1.0, 10.0)
"""Candidate penalties of the ridge regression, relative to the number of anchors (generalised cross-validation)."""


@dataclass(frozen=True)
class Correlogram:
    """Correlation between the attributes of two anchors as a function of their distance d, for kriging.

    The correlation is `correlation * exp(-d / range)` for different anchors, and 1 for an anchor with itself.

    Attributes:
        correlation: Correlation of different anchors at distance 0, at least 0 and less than 1.
        range: Distance at which the correlation has fallen to `correlation / e`, positive. The unit is the distance
            from a lost anchor to its farthest neighbour.
    """

    # Even the closest neighbour leaves the share `1 - correlation` of the variance unexplained (nugget). The unit
    # of `range` adapts it to the dense foreground and the sparse background.

    correlation: float
    range: float


@register_concealer("kriging", needs=[Prior])
@dataclass(frozen=True)
class Kriging:
    """Estimates the attributes of a lost anchor by simple kriging from the nearest received anchors.

    The estimate of a lost anchor (query) is `v_q = m + r^T R^-1 (v_k - m)`. Here m is the expected value (`target`),
    and v_k are the values of the neighbours. R has the correlations between the neighbours, and r the correlations
    between the neighbours and the query. Correlations are fitted to the received anchors.

    Attributes:
        neighbors: Number of received neighbours of each lost anchor (query).
        target: Mean m of an anchor. `residual`: the anchor's prior mean. `absolute`: the mean of all received anchors.
            `regression`: a linear function of the anchor's prior means, fitted to the received anchors.
        sample: Number of received anchors to which correlations are fitted.
        seed: Seed of the sample.
        vote: Rule that determines which offsets of a lost anchor exist (its mask).
    """

    # Each attribute has its own `Correlogram` (correlation as a function of distance): the one with the smallest
    # error when a sample of received anchors is predicted from its received neighbours. If no correlogram predicts
    # better than the mean m, the estimate is m. If a neighbour lacks an offset, the mean m of this offset is used.
    # The mask bits are estimated as numbers from 0 to 1 and then decided by `vote`. `regression` has the least
    # error in every attribute, but not the best picture (docs/concealment.md). Masks always use `absolute`.

    neighbors: int = 16
    target: str = "residual"
    sample: int = 1024
    seed: int = 0
    vote: MaskVote = field(default_factory=MaskVote)

    def __post_init__(self) -> None:
        check_fields(self)
        check_at_least("number of neighbours", self.neighbors, 1)
        check_at_least("sample of anchors", self.sample, 1)
        if self.target not in TARGETS:
            raise InvalidValueError(f"target of kriging must be one of {', '.join(TARGETS)}, not {self.target!r}")

    @property
    def name(self) -> str:
        """Name in the registry of concealers: `kriging`."""
        return "kriging"

    def __call__(self, context: ReceivedScene) -> Concealed:
        """Returns the scene with estimates of the lost attributes."""
        # An attribute that was received for no anchor is set to the prior's mean.
        context = to_tensors(context)
        filled = context.filled
        inputs = regression_inputs(context) if self.target == "regression" else None
        for received, attributes in attributes_by_gap(context):
            if bool(received.any()):
                fields = [_field(context, attribute, self.target, inputs) for attribute in attributes]
                fits = self._fit(context, received, fields)
                for queries, index, distance in _neighborhoods(context, received, self.neighbors):
                    for values, fit in zip(fields, fits, strict=True):
                        weight = kriging_weights(context.positions, index, distance, fit)
                        self._write(filled, values, queries, values.mean[queries] + _combine(values, index, weight))
        return Concealed.filled(replace(filled, scalings=_with_floor(context, filled.scalings)))

    def _fit(self, context: ReceivedScene, received: Bool[Tensor, "N"], fields: list["_Field"]) -> list[Correlogram]:
        """Chooses a correlogram for each attribute: the one that predicts received anchors best from their neighbours.

        Args:
            context: The received scene.
            received: Mask of the anchors whose attributes were received.
            fields: Values of each attribute.

        Returns:
            One correlogram per attribute.
        """
        support = received.nonzero()[:, 0]
        if len(support) < 2:
            return [Correlogram(0.0, 1.0)] * len(fields)
        rng = torch.Generator().manual_seed(self.seed)
        chosen = torch.randperm(len(support), generator=rng)[: self.sample].sort().values
        positions = context.positions
        index, distance = nearest_other_points(
            TensorTree(positions[support]), positions[support[chosen]], chosen, self.neighbors
        )
        own, index = support[chosen], support[index]
        best = [(values.error(own, torch.zeros_like(values.residual[own])), Correlogram(0.0, 1.0)) for values in fields]
        for candidate in (Correlogram(c, r) for c in _CORRELATIONS for r in _RANGES):
            weight = kriging_weights(positions, index, distance, candidate)
            for place, values in enumerate(fields):
                error = values.error(own, _combine(values, index, weight))
                if error < best[place][0]:
                    best[place] = error, candidate
        return [fit for _, fit in best]

    def _write(self, filled: Anchors, values: "_Field", queries: Int64[Tensor, "Q"], estimate: Tensor) -> None:
        if values.attribute is Attribute.MASK:
            filled.mask[queries] = self.vote(estimate.clamp(0, 1), torch.ones(len(queries), dtype=torch.bool))
            return
        target = {
            Attribute.FEATURE: filled.features, Attribute.SCALING: filled.scalings, Attribute.OFFSET: filled.offsets
        }[values.attribute]  # fmt: skip
        target[queries] = estimate.view(len(queries), *target.shape[1:])


def kriging_weights(
    positions: Float[Tensor, "N 3"],
    index: Int64[Tensor, "Q k"],
    distance: Float[Tensor, "Q k"],
    fit: Correlogram,
) -> Float[Tensor, "Q k"]:
    """Computes the kriging weights `R^-1 r` of the neighbours of each lost anchor (query).

    R has the correlations between the neighbours, and r their correlations with the query.

    Args:
        positions: Positions of all anchors.
        index: Anchor indices of the neighbours of each lost anchor (query).
        distance: Distances of the neighbours from the query, farthest last.
        fit: Correlation as a function of distance.
    """
    # The correlation is below 1 even at distance 0, so R is invertible although two neighbours may have the same
    # position.
    if fit.correlation == 0 or index.shape[1] == 0:
        return torch.zeros_like(distance)
    unit = fit.range * distance[:, -1:].clamp(min=torch.finfo(distance.dtype).tiny)
    near = positions[index]
    # differences of positions: the formula with scalar products is imprecise for small distances far from the origin
    between = torch.linalg.vector_norm(near[:, :, None] - near[:, None], dim=3) / unit[:, :, None]
    matrix = fit.correlation * torch.exp(-between)
    matrix.diagonal(dim1=1, dim2=2).fill_(1.0)
    return torch.linalg.solve(matrix, fit.correlation * torch.exp(-distance / unit))


@dataclass(frozen=True, eq=False)
class _Field:
    """Values of one attribute that kriging interpolates: deviations of all anchors from their expected values.

    Attributes:
        attribute: The attribute.
        mean: Expected values of every anchor.
        residual: Received value minus mean; 0 for values that were not received.
        exists: True for values that were received and exist.
        variance: Variance of the residual of each channel.
    """

    attribute: Attribute
    mean: Float[Tensor, "N D"]
    residual: Float[Tensor, "N D"]
    exists: Bool[Tensor, "N D"]
    variance: Float[Tensor, "D"]

    def error(self, rows: Int64[Tensor, "S"], estimate: Float[Tensor, "S D"]) -> float:
        """Computes the squared error of estimated residuals, over all values that were received.

        Args:
            rows: Indices in the scene of the S anchors.
            estimate: Estimated residuals of these anchors.

        Returns:
            Sum of the squared errors, each divided by the variance of its channel.
        """
        wrong = (self.residual[rows] - estimate) ** 2 * self.exists[rows]
        return float((wrong / self.variance).sum())


def regression_inputs(context: ReceivedScene) -> Float64[Tensor, "N P"]:
    """Returns the inputs from which `regress` predicts the attributes of each anchor, received or lost."""
    # The means of all attributes that the prior predicts, standardised over the scene.
    prior = context[Prior]
    means = torch.cat([prior.feature.mean, prior.scaling.mean, prior.offset.mean], dim=1).double()
    spread = means.std(dim=0, correction=0)
    return (means - means.mean(dim=0)) / torch.where(spread > 1e-9, spread, 1.0)


def regress(
    inputs: Float64[Tensor, "N P"], values: Float[Tensor, "N D"], exists: Bool[Tensor, "N D"]
) -> Float[Tensor, "N D"]:
    """Predicts by ridge regression how far the attribute values of all anchors deviate from their mean.

    Args:
        inputs: Inputs of all anchors, from `regression_inputs`.
        values: Deviations of attribute values from their mean; 0 for values that were not received.
        exists: True for received values.

    Returns:
        The predicted deviations of all anchors, received or lost.
    """
    # Kriging uses them as expected values. The prediction is 0 if regression would not reduce the prediction error.
    result = torch.zeros_like(values)
    patterns, group = exists.unique(dim=1, return_inverse=True)
    for number in range(patterns.shape[1]):
        columns, rows = (group == number).nonzero()[:, 0], patterns[:, number]
        weights = _ridge(inputs[rows], values[rows][:, columns].double())
        result[:, columns] = (inputs @ weights).to(values.dtype)
    return result


def _ridge(inputs: Float64[Tensor, "n P"], values: Float64[Tensor, "n D"]) -> Float64[Tensor, "P D"]:
    """Fits a linear function from `inputs` to `values` by ridge regression, and returns its coefficients."""
    # The penalty on large coefficients is the one with the least prediction error, as estimated by generalised
    # cross-validation. If a prediction of zero has an even smaller error, all coefficients are zero.
    count = len(inputs)
    power, axes = torch.linalg.eigh(inputs.T @ inputs)
    power, seen, total = power.clamp(min=0), axes.T @ (inputs.T @ values), float((values**2).sum())
    best, least = torch.zeros_like(seen), total / max(count, 1) ** 2
    for ridge in _RIDGES:
        shrunk = seen / (power + ridge * count + 1e-12)[:, None]
        wrong = total - 2 * float((seen * shrunk).sum()) + float((power[:, None] * shrunk**2).sum())
        free = count - float((power / (power + ridge * count + 1e-12)).sum())
        if free > 1 and wrong / free**2 < least:
            best, least = shrunk, wrong / free**2
    return axes @ best


def _field(context: ReceivedScene, attribute: Attribute, target: str, inputs: Float64[Tensor, "N P"] | None) -> _Field:
    anchors, prior = context.scene.anchors, context[Prior]
    received = context.loss_mask.column(attribute)
    values, mean = {
        Attribute.FEATURE: (anchors.features, prior.feature.mean),
        Attribute.SCALING: (anchors.scalings, prior.scaling.mean),
        Attribute.OFFSET: (anchors.offsets.flatten(1), prior.offset.mean),
        Attribute.MASK: (anchors.mask.to(anchors.positions.dtype), None),
    }[attribute]
    exists = received[:, None].expand_as(values)
    if attribute is Attribute.OFFSET:
        usable = anchors.mask & context.loss_mask.column(Attribute.MASK)[:, None]
        exists = exists & usable.repeat_interleave(3, dim=1)
    count = exists.sum(dim=0).clamp(min=1)
    if target != "residual" or mean is None:  # the prior does not predict masks
        mean = ((values * exists).sum(dim=0) / count).expand_as(values)
        if inputs is not None and attribute is not Attribute.MASK:
            mean = mean + regress(inputs, (values - mean) * exists, exists)
    residual = (values - mean) * exists
    variance = (residual**2).sum(dim=0) / count
    variance = torch.where(variance > 0, variance, 1.0)
    return _Field(attribute, mean, residual, exists, variance)


def _combine(values: _Field, index: Int64[Tensor, "Q k"], weight: Float[Tensor, "Q k"]) -> Float[Tensor, "Q D"]:
    if index.shape[1] == 0:
        return torch.zeros(len(index), values.residual.shape[1], dtype=weight.dtype)
    return torch.nn.functional.embedding_bag(index, values.residual, mode="sum", per_sample_weights=weight)


def _neighborhoods(
    context: ReceivedScene, received: Bool[Tensor, "N"], neighbors: int
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Finds the nearest received anchors of each lost anchor (query).

    Args:
        context: The received scene.
        received: Mask of the anchors that can be neighbours; the others are the queries.
        neighbors: Maximum number of neighbours, k.

    Yields:
        Groups of queries: their indices (Q), the indices of their neighbours (Q, k), and the distances (Q, k).
    """
    positions, support = context.positions, received.nonzero()[:, 0]
    tree = TensorTree(positions[support])
    for queries in (~received).nonzero()[:, 0].split(_CHUNK):
        index, distance = tree.query(positions[queries], neighbors)
        yield queries, support[index], distance


def _with_floor(context: ReceivedScene, scalings: Float[Tensor, "N 6"]) -> Float[Tensor, "N 6"]:
    """Raises estimated scalings of lost anchors to at least the smallest received scaling."""
    # They may be negative.
    missing = ~context.loss_mask.column(Attribute.SCALING)[:, None]
    return torch.where(missing, plausible_scalings(context.scene.anchors, context.loss_mask, scalings), scalings)
