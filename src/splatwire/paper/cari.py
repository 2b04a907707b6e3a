"""CARI, Context-Aware Residual Interpolation: a concealer without learning.

It interpolates residuals (differences of attributes from the means that the hash grid predicts) between anchors.
Source: Section 3.3 of the paper (`docs/paper-map.md`).
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatwire.arguments import check_fields
from splatwire.concealment.base import Concealed, check_at_least
from splatwire.concealment.registry import register_concealer
from splatwire.errors import InvalidValueError
from splatwire.neural.model.tensors import to_tensors
from splatwire.paper.fill import MaskVote, attributes_by_gap, weighted_mean, weighted_mean_of_existing
from splatwire.paper.neighbors import TensorTree, nearest_other_points
from splatwire.paper.ridge import ridge_correction
from splatwire.paper.signature import (
    AttributeGroup,
    Residuals,
    anchors_from,
    attribute_groups,
    residuals_of,
    signatures,
    uncertainties,
    unit_rows,
)
from splatwire.paper.weighting import ScoreExponents, Support, select_neighbors
from splatwire.types import AnchorLayout, Attribute, Prior, ReceivedScene
from splatwire.types.prior import plausible_scalings

_CHUNK = 1 << 13


@register_concealer("cari", needs=[Prior])
@dataclass(frozen=True)
class Cari:
    """Estimates lost anchor attributes by interpolating the residuals of neighbours (CARI, Section 3.3 of the paper).

    A residual is the difference between an attribute and its mean as predicted by the hash grid (the prior). A lost
    attribute is estimated as the predicted mean plus a weighted mean of the neighbours' residuals.

    The `candidates` nearest anchors are scored by distance, similarity of hash-grid features, uncertainty of the prior,
    similarity of residuals, and whether they were received. The `neighbors` anchors with the highest scores are used.
    All defaults are the paper's constants.

    Attributes:
        candidates: Number of nearest anchors that are scored, L in the paper.
        neighbors: Number of neighbours used for the interpolation, K in the paper.
        distance_exponent: Exponent of the distance in the score, alpha.
        context_exponent: Exponent of the similarity of hash-grid features, beta.
        uncertainty_exponent: Exponent of the prior's standard deviation, gamma.
        signature_exponent: Exponent of the similarity of residuals, delta.
        epsilon: Small number added to distances, uncertainties and sums of scores, to avoid division by zero.
        recovered_confidence: Factor on the score of anchors that were concealed in a previous pass.
        passes: Number of passes over the lost anchors; later passes also use anchors concealed before.
        ridge: Penalty of a local linear model that corrects interpolated features; None to disable the correction.
        vote: Rule that determines which offsets of a lost anchor exist (its mask).
        backend: `numba` (compiled), or `torch` (reference).
    """

    # The score is the product `w_geo w_ctx w_unc w_conf w_sig`. There is one score per attribute group (feature
    # groups, scaling, offsets).

    # Our choices for details that the paper does not specify:

    # Signature of a query. In the first pass, a lost anchor has no residuals and thus a zero signature. `w_sig` is
    # then equal for all candidates. From the second pass on, the signature is computed from the residuals of the
    # previous pass.

    # Refinement. In later passes, anchors concealed in the previous pass are also candidates (except for
    # themselves), with confidence `recovered_confidence`. All queries are updated at once, so their order does not
    # matter.

    # Offsets that do not exist have no residual; their weight is distributed over the other neighbours, per offset.
    # The signature's offset mean includes only existing offsets.

    # The mask is lost with its packet. Neighbours vote on it, with the weights of the offsets (`vote`).

    # Estimated sizes are clamped to at least the smallest received size. If no anchor has the attribute, or all
    # scores are zero, the result is the prior's mean. The paper gives no value for `epsilon`.

    candidates: int = 128
    neighbors: int = 8
    distance_exponent: float = 1.0
    context_exponent: float = 2.0
    uncertainty_exponent: float = 1.0
    signature_exponent: float = 1.5
    epsilon: float = 1e-6
    recovered_confidence: float = 0.5
    passes: int = 2
    ridge: float | None = None
    vote: MaskVote = field(default_factory=MaskVote)
    backend: str = "numba"

    def __post_init__(self) -> None:
        check_fields(self)
        check_at_least("number of neighbours", self.neighbors, 1)
        check_at_least("number of candidates", self.candidates, 1)
        check_at_least("number of passes", self.passes, 1)
        for name in ("distance", "context", "uncertainty", "signature"):
            check_at_least(f"{name} exponent", getattr(self, f"{name}_exponent"), 0)
        check_at_least("epsilon", self.epsilon, 1e-12)
        check_at_least("confidence of recovered support", self.recovered_confidence, 0)
        if self.ridge is not None:
            check_at_least("strength of the ridge", self.ridge, 1e-6)
        if self.backend not in ("numba", "torch"):
            raise InvalidValueError(f"backend must be numba or torch, not {self.backend!r}")

    @property
    def name(self) -> str:
        """Name in the registry of concealers: `cari`."""
        return "cari"

    def __call__(self, context: ReceivedScene) -> Concealed:
        """Returns the scene with lost attributes estimated from neighbours."""
        context = to_tensors(context)
        fixed = _prepare(context, self)
        estimate = _Estimate(
            residuals_of(context),
            context.scene.anchors.mask | ~context.loss_mask.column(Attribute.MASK)[:, None],
        )
        for number in range(self.passes):
            estimate = _refine(self, fixed, estimate, first=number == 0)
        anchors = anchors_from(context, estimate.residuals, estimate.mask)
        return Concealed.filled(
            replace(anchors, scalings=plausible_scalings(context.scene.anchors, context.loss_mask, anchors.scalings))
        )


CARI_PRESETS = {"paper": Cari()}
"""Named settings of the concealer; `paper` has the constants of the paper."""


@dataclass(frozen=True, eq=False)
class _ConstantData:
    """Data of a received scene that all passes of CARI share. A pass estimates the lost anchors from their neighbours.

    Attributes:
        context: The received scene.
        groups: Groups of attribute channels that are interpolated with the same neighbours and weights.
        unit_context: Hash-grid feature of each anchor, normalised to length 1.
        certainty: Factor on each anchor's score as a neighbour, per attribute group; `w_unc` in the paper. The factor
            is lower if the prediction for the anchor by the hash grid (the prior) is uncertain.
        tree_of_all: Search tree over the positions of all anchors.
    """

    # The first pass uses received anchors as neighbours only, later passes use concealed ones, too.

    context: ReceivedScene
    groups: tuple[AttributeGroup, ...]
    unit_context: Float[Tensor, "N H"]
    certainty: Float[Tensor, "N G"]
    tree_of_all: TensorTree


@dataclass(frozen=True, eq=False)
class _Estimate:
    """Residuals and offset masks of all anchors, as estimated by CARI so far.

    Attributes:
        residuals: Differences of all attributes from the means predicted by the prior.
        mask: Offset masks of all anchors.
    """

    # Before the first pass, residuals of lost attributes are 0, and lost masks are True.

    residuals: Residuals
    mask: Bool[Tensor, "N K"]


def _prepare(context: ReceivedScene, settings: Cari) -> _ConstantData:
    sigma = uncertainties(context[Prior], context[AnchorLayout])
    return _ConstantData(
        context,
        attribute_groups(context[AnchorLayout]),
        unit_rows(context[Prior].context_features),
        (sigma + settings.epsilon) ** -settings.uncertainty_exponent,
        TensorTree(context.positions),
    )


def _refine(settings: Cari, fixed: _ConstantData, old: _Estimate, *, first: bool) -> _Estimate:
    """Performs one pass of CARI: estimates all lost attributes from neighbours, and returns the new estimates.

    Args:
        settings: Settings of the concealer.
        fixed: Data that does not change between the passes.
        old: Estimates before this pass.
        first: True in the first pass, which uses only received anchors as neighbours.
    """
    # The values of neighbours are taken from `old`, so that the order in which anchors are processed has no
    # influence.
    context = fixed.context
    signature = unit_rows(signatures(old.residuals))
    parts, mask = tuple(part.clone() for part in old.residuals.parts), old.mask.clone()
    for received, attributes in attributes_by_gap(context):
        if not bool(received.any()):
            continue
        groups = [group for group in fixed.groups if group.attribute in attributes]
        certainty = fixed.certainty[:, [fixed.groups.index(group) for group in groups]]
        confidence = torch.where(received, 1.0, settings.recovered_confidence)
        support = Support(fixed.unit_context, signature, certainty * confidence[:, None])
        for queries, candidates, distance in _candidates(settings, fixed, received, first=first):
            chosen = select_neighbors(
                support, queries, candidates, distance, settings.neighbors, _exponents(settings), settings.backend
            )
            for place, group in enumerate(groups):
                index, weight = chosen.index[:, place], chosen.weight[:, place]
                near = _Neighbors(queries, index, weight)
                if group.attribute is Attribute.MASK:
                    mask[queries] = _estimate_masks(settings, old.mask, near)
                else:
                    parts[group.part][queries] = _interpolate(settings, fixed, group, old.residuals, near)
    exists = _known_residuals(context, mask)
    parts[-1].mul_(exists.repeat_interleave(3, dim=1))
    return _Estimate(Residuals(parts, exists), mask)


def _exponents(settings: Cari) -> ScoreExponents:
    return ScoreExponents(
        settings.distance_exponent, settings.context_exponent, settings.signature_exponent, settings.epsilon
    )


def _candidates(
    settings: Cari, fixed: _ConstantData, received: Bool[Tensor, "N"], *, first: bool
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Yields the nearest anchors of each lost anchor (query), as candidates for its neighbours.

    Args:
        settings: Settings of the concealer.
        fixed: Inputs that are the same in all passes; a pass estimates all lost anchors once.
        received: Mask of the anchors whose attribute was received; the others are the queries.
        first: True in the first pass, in which only received anchors are candidates.

    Yields:
        Groups of queries: their indices (Q), the indices of their candidates (Q, L), and the distances (Q, L).
    """
    positions = fixed.context.positions
    support = received.nonzero()[:, 0]
    tree = TensorTree(positions[support]) if first else fixed.tree_of_all
    for queries in (~received).nonzero()[:, 0].split(_CHUNK):
        if first:
            index, distance = tree.query(positions[queries], settings.candidates)
            yield queries, support[index], distance
        else:
            yield queries, *nearest_other_points(tree, positions[queries], queries, settings.candidates)


@dataclass(frozen=True, eq=False)
class _Neighbors:
    """Neighbours of lost anchors (queries) for one attribute group, with their interpolation weights."""

    queries: Int64[Tensor, "Q"]
    index: Int64[Tensor, "Q k"]
    weight: Float[Tensor, "Q k"]


def _estimate_masks(settings: Cari, mask: Bool[Tensor, "N K"], near: _Neighbors) -> Bool[Tensor, "Q K"]:
    """Estimates which offsets of lost anchors (queries) exist, by a weighted vote of their neighbours.

    Args:
        settings: Settings of the concealer, with the rule of the vote.
        mask: Offset masks of all anchors.
        near: Neighbours of the lost anchors, with weights.
    """
    total = near.weight.sum(dim=1, keepdim=True)
    votes = weighted_mean(mask.to(total.dtype), near.index, near.weight)
    return settings.vote(votes / total.clamp(min=torch.finfo(total.dtype).tiny), total[:, 0] > 0)


def _interpolate(
    settings: Cari, fixed: _ConstantData, group: AttributeGroup, residuals: Residuals, near: _Neighbors
) -> Float[Tensor, "Q D"]:
    """Estimates residuals of lost anchors as weighted sums of their neighbours' residuals.

    Args:
        settings: Settings of the concealer.
        fixed: Inputs that are the same in all passes; a pass estimates all lost anchors once.
        group: The attribute channels to estimate.
        residuals: Residuals of all anchors.
        near: Neighbours of the lost anchors, with weights.
    """
    # For features, the optional ridge refinement is added.
    values = residuals.parts[group.part]
    if group.attribute is Attribute.OFFSET:
        return weighted_mean_of_existing(values, residuals.exists, near.index, near.weight)[0]
    mean = weighted_mean(values, near.index, near.weight)
    if settings.ridge is not None and group.attribute is Attribute.FEATURE:
        positions = fixed.context.positions
        offsets = positions[near.index] - positions[near.queries, None]
        mean = mean + ridge_correction(offsets, values[near.index], near.weight, settings.ridge)
    return mean


def _known_residuals(context: ReceivedScene, mask: Bool[Tensor, "N K"]) -> Bool[Tensor, "N K"]:
    """Returns the mask of offsets with a usable residual, either received or estimated in an earlier pass.

    Args:
        context: The received scene.
        mask: Received or estimated offset masks of all anchors.
    """
    # Lost offsets have an interpolated residual after a pass. A received offset has no known residual if the offset
    # mask of its anchor was lost.
    offset = context.loss_mask.column(Attribute.OFFSET)
    usable = ~offset | context.loss_mask.column(Attribute.MASK)
    return mask & usable[:, None]
