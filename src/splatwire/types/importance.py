"""Importance of elements: the fraction of the rendered images that each element contributes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8

from splatwire.reprs import summary_repr


@dataclass(frozen=True, eq=False)
class Importance:
    """Relative importance of N elements: opacity times projected area, summed over a set of views.

    Attributes:
        share: Importance of each element as a fraction of the total. The fractions add up to 1; all are 0 if no element
            is visible.
    """

    share: Float[np.ndarray, "N"]

    __repr__ = summary_repr

    def __post_init__(self) -> None:
        if not bool((np.isfinite(self.share) & (self.share >= 0)).all()):
            raise ValueError("shares of importance must be finite and not negative")

    @staticmethod
    def of_footprints(footprint: Float[np.ndarray, "N"]) -> "Importance":
        """Computes the importance of elements from the image area that each element covers.

        Args:
            footprint: Opacity times projected area of each element, summed over the views, in any unit.
        """
        total = footprint.sum(dtype=np.float64)
        share = footprint / max(total, 1e-300) if total > 0 else np.zeros(len(footprint))
        return Importance(share.astype(footprint.dtype))

    def top(self, fraction: float) -> Bool[np.ndarray, "N"]:
        """Returns the mask of the most important elements.

        Args:
            fraction: Share of all elements to select, 0 to 1; their number is rounded.

        Raises:
            ValueError: If the fraction is not in [0, 1].
        """
        if not 0 <= fraction <= 1:
            raise ValueError(f"a fraction of elements must be in [0, 1], not {fraction!r}")
        chosen = np.zeros(len(self.share), np.bool_)
        order = np.argsort(-self.share, kind="stable")
        chosen[order[: round(fraction * len(order))]] = True
        return chosen

    def tiers(self, fractions: Sequence[float], mask: Bool[np.ndarray, "N"] | None = None) -> UInt8[np.ndarray, "N"]:
        """Divides elements into groups (tiers) by importance; tier 0 is the most important.

        Args:
            fractions: Share of the elements in each tier except the last, 0 to 1; (0.05, 0.15) makes three tiers.
            mask: Mask of the elements to divide by importance. `fractions` are shares of these elements. All other
                elements are in the last tier. None to divide all elements.

        Raises:
            ValueError: If a fraction is not in [0, 1], the sum exceeds 1, or there are more than 255 fractions.
        """
        if sum(fractions) > 1 + 1e-9 or len(fractions) > 255 or not all(0 <= f <= 1 for f in fractions):
            raise ValueError(f"shares of tiers must be in [0, 1] and add up to at most 1, not {list(fractions)}")
        counted = np.ones(len(self.share), np.bool_) if mask is None else mask
        order = np.argsort(-np.where(counted, self.share, -1.0), kind="stable")
        tiers = np.full(self.share.shape, len(fractions), np.uint8)
        ends, number = [0], int(counted.sum())
        for tier, fraction in enumerate(fractions):
            ends.append(round(min(sum(fractions[:tier]) + fraction, 1) * number))
            tiers[order[ends[-2] : ends[-1]]] = tier
        return tiers
