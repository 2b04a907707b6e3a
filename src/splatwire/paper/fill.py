"""Functions shared by the concealers of this package: grouping of lost attributes, means of neighbours, mask votes."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatwire.arguments import check_fields
from splatwire.errors import InvalidValueError
from splatwire.types import Attribute, ReceivedScene

MASK_RULES = ("majority", "count", "all")


@dataclass(frozen=True)
class MaskVote:
    """Vote of a lost anchor's neighbours on which offsets of the lost anchor exist (offset mask).

    The support of an offset is the weight of the neighbours that have this offset, divided by the weight of all
    neighbours. The rules are:

    * `majority`: an offset exists if its support is at least `threshold`;
    * `count`: the anchor gets as many offsets as its neighbours have on average. These are the offsets with the most
      support;
    * `all`: every offset exists.

    Attributes:
        rule: Name of the rule, one of `MASK_RULES`.
        threshold: Minimum support of an offset with the rule `majority`.
    """

    # The paper does not specify a rule, although masks are lost with their packets. Of equal shares, the offset
    # with the lower index wins. Without neighbours, every offset exists.

    rule: str = "majority"
    threshold: float = 0.5

    def __post_init__(self) -> None:
        check_fields(self)
        if self.rule not in MASK_RULES:
            raise InvalidValueError(f"mask rule must be one of {', '.join(MASK_RULES)}, not {self.rule!r}")
        if not 0 < self.threshold <= 1:
            raise InvalidValueError(f"threshold of the mask vote must be in (0, 1], not {self.threshold!r}")

    def __call__(self, share: Float[Tensor, "Q K"], supported: Bool[Tensor, "Q"]) -> Bool[Tensor, "Q K"]:
        """Estimates the offset masks of lost anchors (queries) by the vote of their neighbours.

        Args:
            share: Support of each offset: weight of the neighbours that have this offset, divided by the weight of all
                neighbours, 0 to 1.
            supported: True for queries with at least one neighbour; all offsets of other queries exist.
        """
        if self.rule == "all":
            return torch.ones_like(share, dtype=torch.bool)
        if self.rule == "count":
            order = share.argsort(dim=1, descending=True, stable=True)
            columns = torch.arange(share.shape[1]).expand_as(order)
            rank = torch.empty_like(order).scatter_(1, order, columns)
            exists = rank < share.sum(dim=1, keepdim=True).round()
        else:
            exists = share >= self.threshold - 1e-6  # tolerance for rounding errors at exactly half of the votes
        return exists | ~supported[:, None]


def attributes_by_gap(context: ReceivedScene) -> list[tuple[Bool[Tensor, "N"], tuple[Attribute, ...]]]:
    """Groups the attributes that are missing for exactly the same anchors.

    Attributes that were received for all anchors are left out.

    Returns:
        One pair per group: the mask of the anchors for which the attributes of the group were received, and these
        attributes.
    """
    # Neighbours are searched only once for each group.
    groups: list[tuple[Tensor, list[Attribute]]] = []
    for attribute in Attribute:
        column = context.loss_mask.column(attribute)
        if bool(column.all()):
            continue
        for other, members in groups:
            if torch.equal(other, column):
                members.append(attribute)
                break
        else:
            groups.append((column, [attribute]))
    return [(column, tuple(members)) for column, members in groups]


def weighted_mean(
    values: Float[Tensor, "N D"], index: Int64[Tensor, "Q k"], weight: Float[Tensor, "Q k"]
) -> Float[Tensor, "Q D"]:
    """Returns the weighted mean of the neighbours' values for each lost anchor.

    Args:
        values: Values of all anchors.
        index: Indices of the neighbours of each lost anchor.
        weight: Weights of the neighbours; the sum for a lost anchor is 1 or slightly less.
    """
    # embedding_bag reads the neighbours' values in place: three times faster than first copying all Q k D values
    return torch.nn.functional.embedding_bag(
        index.contiguous(), values, mode="sum", per_sample_weights=weight.contiguous()
    )


def weighted_mean_of_existing(
    values: Float[Tensor, "N D"],
    exists: Bool[Tensor, "N K"],
    index: Int64[Tensor, "Q k"],
    weight: Float[Tensor, "Q k"],
) -> tuple[Float[Tensor, "Q D"], Float[Tensor, "Q K"]]:
    """Averages each of the K offsets of a lost anchor (query) over the neighbours in which this offset exists.

    Args:
        values: K offsets of each anchor, side by side in D columns; zero if an offset does not exist.
        exists: True for offsets that exist.
        index: For each of the Q lost anchors, indices of its k neighbours.
        weight: Weights of the neighbours, not negative.

    Returns:
        Two arrays. The first has the averaged offsets; offsets that exist in no neighbour are zero. The second has the
        support of each offset, 0 to 1: the weight of the neighbours in which the offset exists, divided by the weight
        of all neighbours.
    """
    # Averages are scaled by the sum of the weights, usually 1.
    total = weight.sum(dim=1, keepdim=True)
    has = weighted_mean(exists.to(weight.dtype), index, weight)
    tiny = torch.finfo(weight.dtype).tiny
    factor = (total / has.clamp(min=tiny)).repeat_interleave(values.shape[1] // exists.shape[1], dim=1)
    mean = torch.where(factor <= 1e30, weighted_mean(values, index, weight) * factor, 0.0)
    return mean, has / total.clamp(min=tiny)
