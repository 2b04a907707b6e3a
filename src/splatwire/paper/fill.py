"""What the paper's concealers have in common: gaps by attribute, weighted means of neighbours, mask votes."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from splatwire.errors import InvalidValueError
from splatwire.model import Partial
from splatwire.scene import Attribute

MASK_RULES = ("majority", "count", "all")


@dataclass(frozen=True)
class MaskVote:
    """How the mask of a lost anchor is chosen from the weighted share of its neighbours that have an offset.

    The paper does not say (its packets carry the mask, so it is lost with the rest). `majority`: an offset exists where
    the share reaches `threshold`. `count`: as many offsets as the neighbours have on average (rounded), those with the
    largest shares (equal shares: the lower offset first). `all`: every offset exists. Where no neighbour says anything,
    every offset exists.

    Attributes:
        rule: See above.
        threshold: Share from which an offset exists, for `majority`.
    """

    rule: str = "majority"
    threshold: float = 0.5

    def __post_init__(self) -> None:
        if self.rule not in MASK_RULES:
            raise InvalidValueError(f"mask rule must be one of {', '.join(MASK_RULES)}, not {self.rule!r}")
        if not 0 < self.threshold <= 1:
            raise InvalidValueError(f"threshold of the mask vote must be in (0, 1], not {self.threshold!r}")

    def __call__(self, share: Float[Tensor, "Q K"], supported: Bool[Tensor, "Q"]) -> Bool[Tensor, "Q K"]:
        """Decides.

        Args:
            share: Weighted share of the neighbours that have the offset, 0 to 1.
            supported: Queries that have neighbours at all.
        """
        if self.rule == "all":
            return torch.ones_like(share, dtype=torch.bool)
        if self.rule == "count":
            order = share.argsort(dim=1, descending=True, stable=True)
            places = torch.arange(share.shape[1]).expand_as(order)
            rank = torch.empty_like(order).scatter_(1, order, places)
            exists = rank < share.sum(dim=1, keepdim=True).round()
        else:
            exists = share >= self.threshold - 1e-6  # half of the votes is half, whatever rounding says
        return exists | ~supported[:, None]


def attributes_by_gap(context: Partial) -> list[tuple[Bool[Tensor, "N"], tuple[Attribute, ...]]]:
    """Groups the attributes that are missing from the same anchors: one group if packets are atomic.

    Returns:
        Per group: True where received, and the attributes. Attributes that miss nowhere are not listed.
    """
    groups: list[tuple[Tensor, list[Attribute]]] = []
    for attribute in Attribute:
        column = context.erasures.column(attribute)
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
    """Sums neighbours' values with weights; the weights say whether it is a mean."""
    # A bag of rows is read where it lies: three times faster than gathering Q k D values first.
    return torch.nn.functional.embedding_bag(
        index.contiguous(), values, mode="sum", per_sample_weights=weight.contiguous()
    )


def weighted_mean_of_existing(
    values: Float[Tensor, "N D"],
    exists: Bool[Tensor, "N K"],
    index: Int64[Tensor, "Q k"],
    weight: Float[Tensor, "Q k"],
) -> tuple[Float[Tensor, "Q D"], Float[Tensor, "Q K"]]:
    """The same for K offsets of D / K values, of which a neighbour without the offset has none: others take its weight.

    Args:
        values: Zero where the offset does not exist.
        exists: Whether it exists.
        index: Neighbours.
        weight: Their weights, not negative.

    Returns:
        The sums, zero where no neighbour has the offset; and the share of the weight that lies on neighbours that
        have it, 0 to 1.
    """
    total = weight.sum(dim=1, keepdim=True)
    has = weighted_mean(exists.to(weight.dtype), index, weight)
    tiny = torch.finfo(weight.dtype).tiny
    factor = (total / has.clamp(min=tiny)).repeat_interleave(values.shape[1] // exists.shape[1], dim=1)
    mean = torch.where(factor <= 1e30, weighted_mean(values, index, weight) * factor, 0.0)
    return mean, has / total.clamp(min=tiny)
