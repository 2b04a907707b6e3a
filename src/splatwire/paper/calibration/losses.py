"""Training loss of the inpainting network: a weighted sum of several terms (`LossWeights`).

Source: Section 3.4 of the paper, "Self-supervised ... Training Strategy" (`docs/paper-map.md`).
"""

# Every term is a sum over the lost anchors (queries) of a mini-batch and over channels, except smoothness. Smoothness
# is a mean over pairs of neighbouring queries, as in the paper, so its relative weight depends on the batch size.

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor
from torch.nn import functional

from splatwire.errors import InvalidValueError
from splatwire.paper.gnn.fusion import EPSILON, Branches
from splatwire.paper.neighbors import TensorTree, nearest_other_points
from splatwire.types import Anchors

CHARBONNIER_EPSILON = 1e-3
"""Scale at which the Charbonnier penalty changes from quadratic to linear; the paper gives no value."""


@dataclass(frozen=True)
class LossWeights:
    """Weights of the loss terms; the defaults are the paper's feature-focused configuration.

    Attributes:
        feature: w_f, weight of the error of the features; 0 to leave the features out of all terms.
        scaling: w_s, weight of the error of the scalings.
        offset: w_o, weight of the error of the offsets.
        mask: w_m, weight of the error of the masks.
        active_offset: Factor on the error of offsets that exist.
        distill: Weight (lambda) of the difference between network output and interpolation.
        smooth: Weight (lambda) of the smoothness term: differences between neighbouring lost anchors (queries) of a
            batch.
        prior: Weight (lambda) of the deviation from the prior's mean, in the prior's standard deviations.
        render: Weight (lambda) of the mean absolute difference between pictures of the concealed and the complete
            scene. The difference is multiplied by the number of queries of the batch. 0 disables rendering.
        smooth_neighbors: Number of neighbouring queries per query in the smoothness term, k_lap.
        smooth_bandwidth: Standard deviation of the Gaussian function that weights neighbours by distance in the
            smoothness term, as a multiple of the mean distance of all neighbours. 0 gives all neighbours equal weights.
    """

    # As with `feature`, weights of 0 leave out scalings and offsets.

    feature: float = 1.0
    scaling: float = 0.0
    offset: float = 0.0
    mask: float = 0.0
    active_offset: float = 1.0
    distill: float = 0.25
    smooth: float = 0.05
    prior: float = 0.1
    render: float = 0.0
    smooth_neighbors: int = 8
    smooth_bandwidth: float = 0.0

    def __post_init__(self) -> None:
        bad = [name for name, value in vars(self).items() if not 0 <= value < float("inf")]
        if bad or not (self.feature or self.scaling or self.offset or self.mask):
            raise InvalidValueError(f"weights of the GNN loss must not be negative, and not all 0: {bad or 'all 0'}")

    def trains(self, attribute: str) -> bool:
        """Returns True if an attribute has a positive loss weight, that is, if the attribute is trained."""
        return bool(getattr(self, attribute) > 0)


LOSS_PRESETS = {"feature": LossWeights(), "full": LossWeights(scaling=1.0, offset=1.0, mask=1.0)}
"""Named weights. `feature`: the configuration of the paper. `full`: the loss includes errors of every attribute."""


def weighted_sum(terms: dict[str, Float[Tensor, ""]], weights: LossWeights) -> Float[Tensor, ""]:
    """Adds up the terms of the training loss, each multiplied by the weight of the same name."""
    total = sum(getattr(weights, name) * value for name, value in terms.items())
    assert isinstance(total, Tensor)
    return total


def charbonnier(x: Tensor) -> Tensor:
    """Returns the Charbonnier penalty `sqrt(x ** 2 + epsilon ** 2)`, a smooth absolute value."""
    return torch.sqrt(x * x + CHARBONNIER_EPSILON**2)


def parameter_losses(
    estimates: Branches, truth: Anchors, positions: Float[Tensor, "B 3"], weights: LossWeights
) -> dict[str, Float[Tensor, ""]]:
    """Computes all terms of the training loss that need no rendering.

    Args:
        estimates: Attributes that the network estimates for the lost anchors (queries) of a batch.
        truth: True attributes of the queries.
        positions: Positions of the queries.
        weights: Weights of the terms and attributes.

    Returns:
        The loss terms by name, as in `LossWeights`, not yet multiplied by their weights.
    """
    # Some terms are errors of estimated attributes against the true ones. The others penalise estimates that are
    # far from the interpolation or from the prior's mean, or that differ between neighbours. Terms and attributes
    # with weight 0 are omitted.
    trained = [(name, branch) for name, branch in estimates.continuous() if weights.trains(name)]
    terms: dict[str, Tensor] = {}
    if weights.feature:
        terms["feature"] = _l1(estimates.feature.predicted - truth.features)
    if weights.scaling:
        terms["scaling"] = _l1(estimates.scaling.predicted - truth.scalings)
    if weights.offset:
        active = truth.mask.repeat_interleave(3, dim=1)
        factor = torch.where(active, weights.active_offset, 1.0)
        wrong = charbonnier(estimates.offset.predicted - truth.offsets.flatten(1))
        terms["offset"] = (factor * wrong).sum()
    if weights.mask:
        target = truth.mask.to(estimates.mask_logit.dtype)
        wrong = functional.binary_cross_entropy_with_logits(estimates.mask_logit, target, reduction="none")
        terms["mask"] = wrong.sum()
    if trained and weights.distill:
        terms["distill"] = torch.stack([_l1(b.predicted - b.interpolated) for _, b in trained]).sum()
    if trained and weights.smooth:
        terms["smooth"] = _smoothness([b.predicted for _, b in trained], positions, weights)
    if trained and weights.prior:
        z = [((b.predicted - b.prior.mean) / (b.prior.scale + EPSILON)).abs().mean(dim=1).sum() for _, b in trained]
        terms["prior"] = torch.stack(z).sum()
    return terms


def query_edges(positions: Float[Tensor, "B 3"], neighbors: int) -> tuple[Int64[Tensor, "B k"], Float[Tensor, "B k"]]:
    """Finds the nearest other queries of each query; the queries are the lost anchors of a batch.

    Args:
        positions: Positions of the B queries.
        neighbors: Number of neighbours per query.

    Returns:
        Indices of the neighbours, and their distances.
    """
    everything = torch.arange(len(positions), device=positions.device)
    return nearest_other_points(TensorTree(positions), positions, everything, neighbors)


def _smoothness(values: list[Tensor], positions: Float[Tensor, "B 3"], weights: LossWeights) -> Float[Tensor, ""]:
    index, distance = query_edges(positions, weights.smooth_neighbors)
    if index.numel() == 0:
        return positions.new_zeros(())
    omega = torch.ones_like(distance)
    if weights.smooth_bandwidth > 0:
        width = weights.smooth_bandwidth * distance.mean().clamp(min=1e-12)
        omega = torch.exp(-0.5 * (distance / width) ** 2)
    rough = sum((value[:, None] - value.detach()[index]).abs().sum(dim=2) for value in values)
    return (omega * rough).mean()


def _l1(difference: Float[Tensor, "B D"]) -> Float[Tensor, ""]:
    return difference.abs().sum()


def normalized_errors(
    estimate: Anchors, truth: Anchors, deviations: dict[str, Tensor], rows: Int64[Tensor, "Q"]
) -> dict[str, float]:
    """Computes the error of concealed anchors for each attribute, relative to the spread of the attribute's values.

    Args:
        estimate: Concealed anchors.
        truth: The complete scene.
        deviations: Standard deviations per channel of `features`, `scalings` and `offsets` over the complete scene.
        rows: Indices of the concealed anchors in `truth`.

    Returns:
        RMSE of each attribute in standard deviations, averaged over channels; for the mask, the share of wrong entries.
    """
    real = truth.select(rows)
    exists = real.mask.repeat_interleave(3, dim=1)

    def rmse(wrong: Tensor, counts: Bool[Tensor, "Q D"] | None, scale: Tensor) -> float:
        weight = torch.ones_like(wrong) if counts is None else counts.to(wrong.dtype)
        mean = (wrong**2 * weight).sum(dim=0) / weight.sum(dim=0).clamp(min=1)
        return float((mean.sqrt() / scale).mean())

    return {
        "feature": rmse(estimate.features - real.features, None, deviations["features"]),
        "scaling": rmse(estimate.scalings - real.scalings, None, deviations["scalings"]),
        "offset": rmse((estimate.offsets - real.offsets).flatten(1), exists, deviations["offsets"]),
        "mask": float((estimate.mask != real.mask).double().mean()),
    }


def channel_spread(anchors: Anchors) -> dict[str, Tensor]:
    """Returns the standard deviation of each channel over a scene."""
    # 1 for constant channels.

    def positive(scale: Tensor) -> Tensor:
        return torch.where(scale > 0, scale, 1.0)

    exists = anchors.mask.repeat_interleave(3, dim=1).to(anchors.features.dtype)
    count = exists.sum(dim=0).clamp(min=1)
    offsets = anchors.offsets.flatten(1)
    mean = (offsets * exists).sum(dim=0) / count
    return {
        "features": positive(anchors.features.std(dim=0, correction=0)),
        "scalings": positive(anchors.scalings.std(dim=0, correction=0)),
        "offsets": positive((((offsets - mean) ** 2 * exists).sum(dim=0) / count).sqrt()),
    }
