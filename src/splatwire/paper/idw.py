"""Inverse distance weighting of absolute attributes, and the prior's mean on its own."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatwire.conceal.base import Concealed, check_at_least
from splatwire.conceal.registry import register_concealer
from splatwire.errors import InvalidValueError
from splatwire.model import Partial, Prior
from splatwire.model.tensors import to_tensors
from splatwire.paper.fill import MaskVote, attributes_by_gap, weighted_mean, weighted_mean_of_existing
from splatwire.paper.mahalanobis import MahalanobisSearch
from splatwire.paper.neighbors import TensorTree
from splatwire.scene import Anchors, Attribute

_CHUNK = 1 << 14


@register_concealer("idw", needs=[Prior])
@dataclass(frozen=True)
class Idw:
    """Fills a gap with the mean of the nearest received anchors' attributes, weights `1 / distance ** power`.

    An offset is averaged over the neighbours that have it; the mask is their vote. With no received anchor at all, the
    prior's mean is left.

    Attributes:
        neighbors: How many neighbours, k.
        power: Exponent of the distance.
        metric: `euclidean`, or `mahalanobis`: distance by the neighbour's own covariance, `diag(scaling[:3] ** 2)`,
            the spread of its Gaussians along the world axes. A neighbour whose scaling is missing itself counts as
            round, of mean size.
        vote: How the mask is chosen.
    """

    neighbors: int = 8
    power: float = 1.0
    metric: str = "euclidean"
    vote: MaskVote = field(default_factory=MaskVote)

    def __post_init__(self) -> None:
        check_at_least("number of neighbours", self.neighbors, 1)
        check_at_least("power of the distance", self.power, 0)
        if self.metric not in ("euclidean", "mahalanobis"):
            raise InvalidValueError(f"metric must be euclidean or mahalanobis, not {self.metric!r}")

    @property
    def name(self) -> str:
        """`idw`."""
        return "idw"

    def __call__(self, context: Partial) -> Concealed:
        """See `Concealer`."""
        context = to_tensors(context)
        filled = context.filled
        for received, attributes in attributes_by_gap(context):
            for queries, index, weight in self.neighborhoods(context, received):
                fill_from_neighbors(context.scene.anchors, filled, attributes, queries, index, weight, self.vote)
        return Concealed.filled(filled)

    def neighborhoods(self, context: Partial, received: Bool[Tensor, "N"]) -> Iterator[tuple[Tensor, ...]]:
        """Yields, chunk by chunk, the anchors not received, their neighbours ("Q k") and weights that sum to 1."""
        context, received = to_tensors((context, received))
        support, lost = received.nonzero()[:, 0], (~received).nonzero()[:, 0]
        if not len(support):
            return
        positions = context.places
        near: TensorTree | MahalanobisSearch = TensorTree(positions[support])
        if self.metric == "mahalanobis":
            near = MahalanobisSearch(positions[support], _extents(context)[support])
        for queries in lost.split(_CHUNK):
            index, distance = near.query(positions[queries], self.neighbors)
            yield queries, support[index], inverse_distance_weights(distance, self.power)


def inverse_distance_weights(distance: Float[Tensor, "Q k"], power: float | int) -> Float[Tensor, "Q k"]:
    """Weights `distance ** -power`, normalised to sum 1; neighbours at distance 0 share the weight among themselves."""
    nearest = distance[:, :1]
    # Relative to the nearest neighbour, so that no unit of length overflows; 0 / 0 is not taken.
    ratio = torch.where(nearest > 0, nearest / distance, (distance == 0).to(distance.dtype))
    weight = ratio**power
    return weight / weight.sum(dim=1, keepdim=True)


def _extents(context: Partial) -> Float[Tensor, "N 3"]:
    """The sizes that are the anchors' covariances; the mean size where an anchor's own is missing."""
    size = context.scene.anchors.scalings[:, :3]
    known = context.erasures.column(Attribute.SCALING) & (size > 0).all(dim=1)
    mean = size[known].mean() if bool(known.any()) else size.new_ones(())
    return torch.where(known[:, None], size, mean)


def fill_from_neighbors(
    anchors: Anchors,
    filled: Anchors,
    attributes: tuple[Attribute, ...],
    queries: Int64[Tensor, "Q"],
    index: Int64[Tensor, "Q k"],
    weight: Float[Tensor, "Q k"],
    vote: MaskVote,
) -> None:
    """Writes the neighbours' means of `attributes` into the rows `queries` of `filled`.

    Args:
        anchors: What was received.
        filled: What is written to; where no neighbour has an offset, it stays as it is.
        attributes: What to fill.
        queries: Rows to fill.
        index: Their neighbours.
        weight: The neighbours' weights, which sum to 1.
        vote: How the mask is chosen.
    """
    if Attribute.FEATURE in attributes:
        filled.features[queries] = weighted_mean(anchors.features, index, weight)
    if Attribute.SCALING in attributes:
        filled.scalings[queries] = weighted_mean(anchors.scalings, index, weight)
    if Attribute.OFFSET in attributes:
        values = (anchors.offsets * anchors.mask[:, :, None]).flatten(1)
        mean, share = weighted_mean_of_existing(values, anchors.mask, index, weight)
        mean = mean.view(len(queries), -1, 3)
        filled.offsets[queries] = torch.where(share[:, :, None] > 0, mean, filled.offsets[queries])
    if Attribute.MASK in attributes:
        share = weighted_mean(anchors.mask.to(weight.dtype), index, weight)
        filled.mask[queries] = vote(share, torch.ones(len(queries), dtype=torch.bool))


@register_concealer("prior", needs=[Prior])
@dataclass(frozen=True)
class PriorMean:
    """Fills a gap with the mean that the hash grid predicts (the paper's prior prediction, no residual).

    The prior says nothing about which offsets exist: the nearest received anchors vote, weighted by inverse distance.

    Attributes:
        neighbors: How many neighbours vote.
        vote: How the mask is chosen.
    """

    neighbors: int = 8
    vote: MaskVote = field(default_factory=MaskVote)

    def __post_init__(self) -> None:
        check_at_least("number of neighbours", self.neighbors, 1)

    @property
    def name(self) -> str:
        """`prior`."""
        return "prior"

    def __call__(self, context: Partial) -> Concealed:
        """See `Concealer`."""
        context = to_tensors(context)
        filled = context.filled
        received = context.erasures.column(Attribute.MASK)
        for queries, index, weight in Idw(neighbors=self.neighbors).neighborhoods(context, received):
            fill_from_neighbors(context.scene.anchors, filled, (Attribute.MASK,), queries, index, weight, self.vote)
        return Concealed.filled(filled)
