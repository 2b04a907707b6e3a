"""Concealers `idw` (inverse distance weighting of attributes) and `prior` (mean that the hash grid predicts)."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatwire.arguments import check_fields
from splatwire.concealment.base import Concealed, check_at_least
from splatwire.concealment.registry import register_concealer
from splatwire.errors import InvalidValueError
from splatwire.neural.model.tensors import to_tensors
from splatwire.paper.fill import MaskVote, attributes_by_gap, weighted_mean, weighted_mean_of_existing
from splatwire.paper.mahalanobis import MahalanobisSearch
from splatwire.paper.neighbors import TensorTree
from splatwire.types import Anchors, Attribute, Prior, ReceivedScene

_CHUNK = 1 << 14


@register_concealer("idw", needs=[Prior])
@dataclass(frozen=True)
class Idw:
    """Estimates a lost anchor by inverse distance weighting of the nearest received anchors, `1 / distance ** power`.

    Attributes:
        neighbors: Number of neighbours, k.
        power: Exponent of the distance.
        metric: `euclidean`, or `mahalanobis` with the neighbour's covariance `diag(scaling[:3] ** 2)`.
        vote: Rule that determines which offsets of a lost anchor exist (its mask).
    """

    # An offset is averaged over the neighbours that have it. Without received anchors, the result is the prior's
    # mean. The scalings are the extent of the neighbour's Gaussians along the world axes. A neighbour with missing
    # scaling is assumed to be a sphere of mean size.

    neighbors: int = 8
    power: float = 1.0
    metric: str = "euclidean"
    vote: MaskVote = field(default_factory=MaskVote)

    def __post_init__(self) -> None:
        check_fields(self)
        check_at_least("number of neighbours", self.neighbors, 1)
        check_at_least("power of the distance", self.power, 0)
        if self.metric not in ("euclidean", "mahalanobis"):
            raise InvalidValueError(f"metric must be euclidean or mahalanobis, not {self.metric!r}")

    @property
    def name(self) -> str:
        """Name in the registry of concealers: `idw`."""
        return "idw"

    def __call__(self, context: ReceivedScene) -> Concealed:
        """Returns the scene with estimates of the lost attributes."""
        context = to_tensors(context)
        filled = context.filled
        for received, attributes in attributes_by_gap(context):
            for queries, index, weight in self.neighborhoods(context, received):
                fill_from_neighbors(context.scene.anchors, filled, attributes, queries, index, weight, self.vote)
        return Concealed.filled(filled)

    def neighborhoods(self, context: ReceivedScene, received: Bool[Tensor, "N"]) -> Iterator[tuple[Tensor, ...]]:
        """Finds the nearest received anchors of each lost anchor (query), and their weights for the interpolation.

        Args:
            context: The received scene.
            received: Mask of the anchors that can be neighbours; the others are the queries.

        Yields:
            Groups of queries: their indices (Q), the indices of their neighbours (Q, k), and the weights of the
            neighbours (Q, k), with sum 1 per query.
        """
        context, received = to_tensors((context, received))
        support, lost = received.nonzero()[:, 0], (~received).nonzero()[:, 0]
        if not len(support):
            return
        positions = context.positions
        near: TensorTree | MahalanobisSearch = TensorTree(positions[support])
        if self.metric == "mahalanobis":
            near = MahalanobisSearch(positions[support], _extents(context)[support])
        for queries in lost.split(_CHUNK):
            index, distance = near.query(positions[queries], self.neighbors)
            yield queries, support[index], inverse_distance_weights(distance, self.power)


def inverse_distance_weights(distance: Float[Tensor, "Q k"], power: float | int) -> Float[Tensor, "Q k"]:
    """Returns weights `distance ** -power`, normalised to sum 1."""
    # If a distance is 0, the other neighbours get 0.
    nearest = distance[:, :1]
    # distances relative to the nearest neighbour avoid overflow in any unit of length; `where` does not select 0 / 0
    ratio = torch.where(nearest > 0, nearest / distance, (distance == 0).to(distance.dtype))
    weight = ratio**power
    return weight / weight.sum(dim=1, keepdim=True)


def _extents(context: ReceivedScene) -> Float[Tensor, "N 3"]:
    """Returns the sizes of anchors along the world axes, by which the Mahalanobis distance is normalised.

    Anchors with lost sizes get the mean size.
    """
    # The mean size for anchors with missing scaling.
    size = context.scene.anchors.scalings[:, :3]
    known = context.loss_mask.column(Attribute.SCALING) & (size > 0).all(dim=1)
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
    """Writes weighted means of the neighbours' attributes to lost anchors, in place.

    Args:
        anchors: All anchors as received; source of the neighbours' values.
        filled: Output: all anchors, whose rows `queries` are changed.
        attributes: Attributes to fill.
        queries: Indices of the anchors to fill.
        index: Anchor indices of the neighbours of each query.
        weight: Weights of the neighbours, with sum 1 per query.
        vote: Rule that determines which offsets of a lost anchor exist (its mask).
    """
    # An offset that exists in no neighbour is not changed.
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
    """Replaces each lost anchor by the mean that the hash grid predicts from the anchor's position.

    Attributes:
        neighbors: Number of neighbours that vote on which offsets exist.
        vote: Rule that determines which offsets of a lost anchor exist (its mask).
    """

    # The prior does not predict masks. The nearest received anchors vote on them, weighted by inverse distance.

    neighbors: int = 8
    vote: MaskVote = field(default_factory=MaskVote)

    def __post_init__(self) -> None:
        check_fields(self)
        check_at_least("number of neighbours", self.neighbors, 1)

    @property
    def name(self) -> str:
        """Name in the registry of concealers: `prior`."""
        return "prior"

    def __call__(self, context: ReceivedScene) -> Concealed:
        """Returns the scene with estimates of the lost attributes."""
        context = to_tensors(context)
        filled = context.filled
        received = context.loss_mask.column(Attribute.MASK)
        for queries, index, weight in Idw(neighbors=self.neighbors).neighborhoods(context, received):
            fill_from_neighbors(context.scene.anchors, filled, (Attribute.MASK,), queries, index, weight, self.vote)
        return Concealed.filled(filled)
