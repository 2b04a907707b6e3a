"""How much of the picture each anchor is."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor


@dataclass(frozen=True, eq=False)
class Importance:
    """Shares of N anchors in the footprint of a scene: opacity times projected area, over a set of views.

    Attributes:
        share: Not negative; sums to 1, or is 0 everywhere if no anchor was seen.
    """

    share: Float[Tensor, "N"]

    def __post_init__(self) -> None:
        if not bool((self.share.isfinite() & (self.share >= 0)).all()):
            raise ValueError("shares of importance must be finite and not negative")

    @staticmethod
    def of_footprints(footprint: Float[Tensor, "N"]) -> "Importance":
        """Normalises footprints (any unit, not negative) to shares."""
        total = footprint.double().sum()
        share = torch.where(total > 0, footprint.double() / total.clamp(min=1e-300), 0.0)
        return Importance(share.to(footprint.dtype))

    def top(self, fraction: float) -> Bool[Tensor, "N"]:
        """Picks the most important anchors: `fraction` of all, rounded; equal shares: the lower index first.

        Raises:
            ValueError: If the fraction is not in [0, 1].
        """
        if not 0 <= fraction <= 1:
            raise ValueError(f"a fraction of anchors must be in [0, 1], not {fraction!r}")
        chosen = torch.zeros(len(self.share), dtype=torch.bool, device=self.share.device)
        order = self.share.argsort(descending=True, stable=True)
        chosen[order[: round(fraction * len(order))]] = True
        return chosen

    def held_by(self, chosen: Bool[Tensor, "N"]) -> float:
        """Share of the footprint that some anchors hold together."""
        return float(self.share.double()[chosen].sum())
