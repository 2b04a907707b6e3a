"""What losing anchors does to the picture, in numbers that a planner can look up."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from splatwire.errors import InvalidValueError
from splatwire.plan.outline import StreamLoad

BLANK_MSE = 0.25
"""What is seen without side information and without a preview: nothing."""
BLANK_PSNR = -10 * float(np.log10(BLANK_MSE))

Picture = Callable[[np.ndarray], float]
"""Draws what arrived: from packets in sending order, bool (P), to decibels."""


@dataclass(frozen=True, eq=False)
class Damage:
    """What losing anchors does to the picture, after concealment.

    Losses are measured as they come: a tier that is protected better than the next loses less, so that losses never
    fall from tier to tier. `mse[t]` is what is added where tier t *and all less important ones* lose the same share; a
    loss of different shares is a sum of steps between these curves, exact where only two different shares occur, one
    of them 0. Tiers lost one at a time and added up say too much: a concealer enlarges what is there, and a hole in
    the small anchors looks to the large ones around it like a hole in everything.

    Attributes:
        shares: Lost shares of a tier at which the damage was measured, ascending from 0, float64 (S).
        mse: Mean squared error that the loss of this share of each tier and of all after it adds, float64 (T, S).
        base_mse: Mean squared error of the complete scene against what it shows.
    """

    shares: np.ndarray
    mse: np.ndarray
    base_mse: float

    def __post_init__(self) -> None:
        rising = len(self.shares) > 1 and self.shares[0] == 0 and bool((np.diff(self.shares) > 0).all())
        fits = self.mse.ndim == 2 and self.mse.shape[1] == len(self.shares)
        if not (rising and fits and np.isfinite(self.mse).all() and self.base_mse > 0):
            raise InvalidValueError("damage must be finite, over lost shares that ascend from 0, on a positive base")

    def psnr(self, lost: np.ndarray) -> np.ndarray:
        """PSNR for lost shares of each tier.

        Args:
            lost: Float64 (trials, T).

        Returns:
            Decibels, float64 (trials).
        """
        added, before = np.zeros(len(lost)), np.zeros(len(lost))
        for tier, curve in enumerate(self.mse):
            here = lost[:, tier]
            added += np.interp(here, self.shares, curve) - np.interp(before, self.shares, curve)
            before = here
        return -10 * np.log10(self.base_mse + np.maximum(added, 0))


@dataclass(frozen=True, eq=False)
class Offer:
    """A stream that may be served, and what is known about its pictures; several of one scene may compete.

    Attributes:
        load: The stream.
        damage: What losses of each tier cost.
        picture: Draws what arrived of this stream; the best of what `damage` suggests are compared by it. None decides
            by `damage` alone.
        concealment_bytes: Bytes of its side information that are there for the case of losses only, such as a sketch:
            they count as protection.
        preview_bytes: Bytes of the preview in the welcome; they count as protection and against the budget.
        blank_psnr: What is seen without side information, decibels: the preview's, if there is one.

    Raises:
        InvalidValueError: If tiers and damage do not fit.
    """

    load: StreamLoad
    damage: Damage
    picture: Picture | None = None
    concealment_bytes: int = 0
    preview_bytes: int = 0
    blank_psnr: float = BLANK_PSNR

    def __post_init__(self) -> None:
        if len(self.damage.mse) != self.load.num_tiers:
            raise InvalidValueError(f"damage of {len(self.damage.mse)} tiers, and the stream has {self.load.num_tiers}")
        if not 0 <= self.concealment_bytes <= self.load.head_bytes:
            raise InvalidValueError(
                f"{self.concealment_bytes} bytes for concealers in a head object of {self.load.head_bytes}"
            )
        if self.preview_bytes < 0 or not np.isfinite(self.blank_psnr):
            raise InvalidValueError(f"a preview of {self.preview_bytes} bytes and {self.blank_psnr} dB")

    def left(self, budget_bytes: float | int) -> float:
        """What a budget leaves for datagrams after the welcome."""
        return float(max(budget_bytes - self.preview_bytes, 0))


def lost_shares(load: StreamLoad, packets: np.ndarray) -> np.ndarray:
    """Share of each tier's anchors that is not there.

    Args:
        load: The stream.
        packets: Which packets are there, bool (T, P).

    Returns:
        Float64 (T, tiers).
    """
    weights = np.zeros((len(load.elements), load.num_tiers))
    weights[np.arange(len(load.elements)), load.tiers] = load.elements
    return (~packets) @ (weights / weights.sum(axis=0))
