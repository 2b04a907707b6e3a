"""How much of the picture each anchor is."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8

from splatwire.reprs import summary_repr


@dataclass(frozen=True, eq=False)
class Importance:
    """Shares of N anchors in the footprint of a scene: opacity times projected area, over a set of views.

    Attributes:
        share: Not negative; sums to 1, or is 0 everywhere if no anchor was seen.
    """

    share: Float[np.ndarray, "N"]

    __repr__ = summary_repr

    def __post_init__(self) -> None:
        if not bool((np.isfinite(self.share) & (self.share >= 0)).all()):
            raise ValueError("shares of importance must be finite and not negative")

    @staticmethod
    def of_footprints(footprint: Float[np.ndarray, "N"]) -> "Importance":
        """Normalises footprints (any unit, not negative) to shares."""
        total = footprint.sum(dtype=np.float64)
        share = footprint / max(total, 1e-300) if total > 0 else np.zeros(len(footprint))
        return Importance(share.astype(footprint.dtype))

    def top(self, fraction: float) -> Bool[np.ndarray, "N"]:
        """Picks the most important anchors: `fraction` of all, rounded; equal shares: the lower index first.

        Raises:
            ValueError: If the fraction is not in [0, 1].
        """
        if not 0 <= fraction <= 1:
            raise ValueError(f"a fraction of anchors must be in [0, 1], not {fraction!r}")
        chosen = np.zeros(len(self.share), np.bool_)
        order = np.argsort(-self.share, kind="stable")
        chosen[order[: round(fraction * len(order))]] = True
        return chosen

    def tiers(self, fractions: Sequence[float], among: Bool[np.ndarray, "N"] | None = None) -> UInt8[np.ndarray, "N"]:
        """Groups anchors by importance: tier 0 is the top share, tier 1 the next one, the last what is left.

        Args:
            fractions: Share of the anchors in each tier but the last, 0 to 1; (0.05, 0.15) makes three tiers.
            among: The anchors that are counted, for example those that are coded; the others are in the last tier.

        Raises:
            ValueError: If a fraction is not in [0, 1], they add up to more than 1, or there are more than 255.
        """
        if sum(fractions) > 1 + 1e-9 or len(fractions) > 255 or not all(0 <= f <= 1 for f in fractions):
            raise ValueError(f"shares of tiers must be in [0, 1] and add up to at most 1, not {list(fractions)}")
        counted = np.ones(len(self.share), np.bool_) if among is None else among
        order = np.argsort(-np.where(counted, self.share, -1.0), kind="stable")
        tiers = np.full(self.share.shape, len(fractions), np.uint8)
        ends, number = [0], int(counted.sum())
        for tier, fraction in enumerate(fractions):
            ends.append(round(min(sum(fractions[:tier]) + fraction, 1) * number))
            tiers[order[ends[-2] : ends[-1]]] = tier
        return tiers
