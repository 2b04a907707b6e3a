"""CARI, Context-Aware Residual Interpolation: the paper's classical concealer (Section 3.3)."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatwire.conceal.base import Concealed, check_at_least
from splatwire.conceal.registry import register_concealer
from splatwire.errors import InvalidValueError
from splatwire.model import Partial, Prior
from splatwire.model.prior import plausible_scalings
from splatwire.model.tensors import to_tensors
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
from splatwire.scene import AnchorLayout, Attribute

_CHUNK = 1 << 13


@register_concealer("cari", needs=[Prior])
@dataclass(frozen=True)
class Cari:
    """Adds to the prior's mean a weighted mean of the neighbours' residuals; every default is the paper's constant.

    Per query, the `candidates` nearest anchors that have the attribute are scored with `w_geo w_ctx w_unc w_conf
    w_sig`, once per attribute group (feature groups, scaling, offsets), and the `neighbors` strongest interpolate.

    What the paper leaves open, and what is done here:

    * A query's own signature. In the first pass nothing of a lost anchor is known but its prior, so its residuals are
      zero, the cosine with the zero signature is 0 and `w_sig` is the same for all candidates: without effect.
      From the second pass on its signature comes from the residuals that the previous pass gave it.
    * Refinement. In a later pass every anchor that the previous pass concealed supports the others (never itself), with
      confidence `recovered_confidence`; all queries are updated at once, so their order does not matter.
    * Offsets that do not exist have no residual: the other neighbours take over their weight, per offset. The
      signature's offset mean is over existing offsets.
    * The mask is lost with its packet: neighbours weighted as for the offsets vote on it (`vote`).
    * A size is kept at least as large as the smallest received one.
    * If no anchor has the attribute (or all scores are zero), the prior's mean is left.

    Attributes:
        candidates: Nearest anchors that are scored, L.
        neighbors: Strongest of them that interpolate, K.
        distance_exponent: alpha.
        context_exponent: beta, of the hash-context similarity.
        uncertainty_exponent: gamma, of the prior's scale.
        signature_exponent: delta, of the similarity of residual signatures.
        epsilon: Added to distances, uncertainties and the sum of scores; the paper names no value.
        recovered_confidence: Confidence of support that was concealed in a previous pass.
        passes: Refinement passes.
        ridge: Strength of the ridge refinement of features (`splatwire.paper.ridge`); None leaves it out.
        vote: How the mask is chosen.
        backend: `numba`, or `torch` for the plain version.
    """

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
        """`cari`."""
        return "cari"

    def __call__(self, context: Partial) -> Concealed:
        """See `Concealer`."""
        context = to_tensors(context)
        fixed = _prepare(context, self)
        estimate = _Estimate(
            residuals_of(context),
            context.scene.anchors.mask | ~context.erasures.column(Attribute.MASK)[:, None],
        )
        for number in range(self.passes):
            estimate = _refine(self, fixed, estimate, first=number == 0)
        anchors = anchors_from(context, estimate.residuals, estimate.mask)
        return Concealed.filled(
            replace(anchors, scalings=plausible_scalings(context.scene.anchors, context.erasures, anchors.scalings))
        )


CARI_PRESETS = {"paper": Cari()}
"""Named settings; `paper` holds the paper's constants and nothing else."""


@dataclass(frozen=True, eq=False)
class _Fixed:
    """What no pass changes.

    Attributes:
        groups: Attribute groups.
        unit_context: Hash-grid features of length 1.
        certainty: `w_unc` per group.
        everyone: All anchors, for the later passes.
    """

    context: Partial
    groups: tuple[AttributeGroup, ...]
    unit_context: Float[Tensor, "N H"]
    certainty: Float[Tensor, "N G"]
    everyone: TensorTree


@dataclass(frozen=True, eq=False)
class _Estimate:
    """What a pass leaves to the next one: residuals (0 where still unknown) and masks (all True where unknown)."""

    residuals: Residuals
    mask: Bool[Tensor, "N K"]


def _prepare(context: Partial, settings: Cari) -> _Fixed:
    sigma = uncertainties(context[Prior], context[AnchorLayout])
    return _Fixed(
        context,
        attribute_groups(context[AnchorLayout]),
        unit_rows(context[Prior].context),
        (sigma + settings.epsilon) ** -settings.uncertainty_exponent,
        TensorTree(context.places),
    )


def _refine(settings: Cari, fixed: _Fixed, old: _Estimate, *, first: bool) -> _Estimate:
    """One pass over all gaps; reads the old estimate only, so that the order of queries does not matter."""
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
                    mask[queries] = _vote(settings, old.mask, near)
                else:
                    parts[group.part][queries] = _interpolate(settings, fixed, group, old.residuals, near)
    exists = _existing(context, mask)
    parts[-1].mul_(exists.repeat_interleave(3, dim=1))
    return _Estimate(Residuals(parts, exists), mask)


def _exponents(settings: Cari) -> ScoreExponents:
    return ScoreExponents(
        settings.distance_exponent, settings.context_exponent, settings.signature_exponent, settings.epsilon
    )


def _candidates(
    settings: Cari, fixed: _Fixed, received: Bool[Tensor, "N"], *, first: bool
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Yields, chunk by chunk, queries, their nearest candidates ("Q L") and distances."""
    positions = fixed.context.places
    support = received.nonzero()[:, 0]
    tree = TensorTree(positions[support]) if first else fixed.everyone
    for queries in (~received).nonzero()[:, 0].split(_CHUNK):
        if first:
            index, distance = tree.query(positions[queries], settings.candidates)
            yield queries, support[index], distance
        else:
            yield queries, *nearest_other_points(tree, positions[queries], queries, settings.candidates)


@dataclass(frozen=True, eq=False)
class _Neighbors:
    """The neighbours that interpolate one attribute group of some queries."""

    queries: Int64[Tensor, "Q"]
    index: Int64[Tensor, "Q k"]
    weight: Float[Tensor, "Q k"]


def _vote(settings: Cari, mask: Bool[Tensor, "N K"], near: _Neighbors) -> Bool[Tensor, "Q K"]:
    """The mask that the neighbours vote for."""
    total = near.weight.sum(dim=1, keepdim=True)
    votes = weighted_mean(mask.to(total.dtype), near.index, near.weight)
    return settings.vote(votes / total.clamp(min=torch.finfo(total.dtype).tiny), total[:, 0] > 0)


def _interpolate(
    settings: Cari, fixed: _Fixed, group: AttributeGroup, residuals: Residuals, near: _Neighbors
) -> Float[Tensor, "Q D"]:
    """The paper's `r_q = sum of w r_k` for one attribute group."""
    values = residuals.parts[group.part]
    if group.attribute is Attribute.OFFSET:
        return weighted_mean_of_existing(values, residuals.exists, near.index, near.weight)[0]
    mean = weighted_mean(values, near.index, near.weight)
    if settings.ridge is not None and group.attribute is Attribute.FEATURE:
        positions = fixed.context.places
        offsets = positions[near.index] - positions[near.queries, None]
        mean = mean + ridge_correction(offsets, values[near.index], near.weight, settings.ridge)
    return mean


def _existing(context: Partial, mask: Bool[Tensor, "N K"]) -> Bool[Tensor, "N K"]:
    """Offsets that have a residual after a pass: received ones whose mask was received, and concealed ones."""
    offset = context.erasures.column(Attribute.OFFSET)
    usable = ~offset | context.erasures.column(Attribute.MASK)
    return mask & usable[:, None]
