"""Predicts the picture errors that lost elements of each importance tier cause."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from splatwire.arguments import array_of, check_fields, checked
from splatwire.errors import InvalidValueError, shown, whole_number
from splatwire.planning.transfer_model import StreamLoad

BLANK_MSE = 0.25
"""Mean squared error if nothing can be drawn, because the side information is lost and there is no preview."""
BLANK_PSNR = -10 * float(np.log10(BLANK_MSE))

Picture = Callable[[np.ndarray], float]
"""Function that renders a stream with losses: maps a mask of received packets, bool (P), to the PSNR in dB."""


@dataclass(frozen=True, eq=False)
class DistortionModel:
    """Predicts the picture error after packet losses and concealment from measured curves, without rendering.

    Attributes:
        shares: Lost shares at which errors were measured, ascending from 0, float64 (S).
        mse: Increase of the mean squared error, float64 (T, S), for T importance tiers. Entry (t, s) is the increase if
            tier t and all less important tiers lose the share `shares[s]` of their elements.
        base_mse: Mean squared error of the complete scene against the references.
    """

    shares: np.ndarray
    mse: np.ndarray
    base_mse: float

    def __post_init__(self) -> None:
        check_fields(self)
        shares = array_of(self.shares, "DistortionModel.shares", ("S",))
        if not (len(shares) > 1 and shares[0] == 0 and bool((np.diff(shares) > 0).all())):
            raise InvalidValueError(f"DistortionModel.shares: lost shares must ascend from 0, not {shown(shares)}")
        mse = array_of(self.mse, "DistortionModel.mse", ("T", len(shares)))
        if not len(mse) or not np.isfinite(mse).all():
            raise InvalidValueError(f"DistortionModel.mse: expected finite numbers of each tier, not {shown(mse)}")
        if not 0 < self.base_mse < math.inf:
            raise InvalidValueError(f"DistortionModel.base_mse must be positive, not {shown(self.base_mse)}")

    def psnr(self, lost: np.ndarray) -> np.ndarray:
        """Predicts the PSNR of the pictures after each simulated transfer.

        Args:
            lost: Lost share of each of T importance tiers in each transfer, float64 (trials, T).

        Returns:
            Decibels, float64 (trials).
        """
        # Raises the lost share of all tiers to that of tier 0, then of all but tier 0 to that of tier 1, and so on.
        # Errors of single tiers cannot be added: a concealer enlarges elements of all sizes even if only small ones
        # were lost, so the sum would be too large.
        added, before = np.zeros(len(lost)), np.zeros(len(lost))
        for tier, curve in enumerate(self.mse):
            shares = lost[:, tier]
            added += np.interp(shares, self.shares, curve) - np.interp(before, self.shares, curve)
            before = shares
        return -10 * np.log10(self.base_mse + np.maximum(added, 0))


@dataclass(frozen=True, eq=False)
class StreamVariant:
    """Encoding of a scene that the planner may choose, with a model of the picture quality after losses.

    Attributes:
        load: Sizes of the stream's packets.
        distortion: Predicts the picture error from the lost share of each importance tier.
        picture: Renders the scene after given losses, to check predictions; None to rely on `distortion`.
        concealment_bytes: Bytes of the side information that serve loss concealment only; they count as redundancy.
        preview_bytes: Size of the preview in bytes; it counts as redundancy.
        blank_psnr: PSNR if no side information arrives, decibels. It is the PSNR of the preview, or of an empty picture
            if there is no preview.

    Raises:
        InvalidValueError: If numbers of tiers differ, or a size is out of range.
    """

    load: StreamLoad
    distortion: DistortionModel
    picture: Picture | None = None
    concealment_bytes: int = 0
    preview_bytes: int = 0
    blank_psnr: float = BLANK_PSNR

    def __post_init__(self) -> None:
        check_fields(self)
        if len(self.distortion.mse) != self.load.num_tiers:
            raise InvalidValueError(
                f"damage of {len(self.distortion.mse)} tiers, and the stream has {self.load.num_tiers}"
            )
        if not 0 <= self.concealment_bytes <= self.load.init_segment_bytes:
            raise InvalidValueError(
                f"StreamVariant.concealment_bytes: {shown(self.concealment_bytes)} bytes for concealers in an "
                f"init segment of {self.load.init_segment_bytes}"
            )
        whole_number(self.preview_bytes, "StreamVariant.preview_bytes")
        if not abs(self.blank_psnr) < math.inf:
            raise InvalidValueError(f"StreamVariant.blank_psnr must be finite, not {shown(self.blank_psnr)}")

    def budget_after_preview(self, budget_bytes: float | int) -> float:
        """Returns the bytes of a budget that are left after the preview is sent, at least 0."""
        return float(max(budget_bytes - self.preview_bytes, 0))


@checked
def lost_fractions(load: StreamLoad, packets: np.ndarray) -> np.ndarray:
    """Returns the lost fraction of the elements of each importance tier in simulated transfers.

    Args:
        load: Sizes and tiers of the stream's packets.
        packets: Mask of received or recovered packets in T transfers, bool (T, P).

    Returns:
        Lost fractions, float64 (T, tiers).
    """
    packets = array_of(packets, "packets", ("T", len(load.elements)), "b")
    weights = np.zeros((len(load.elements), load.num_tiers))
    weights[np.arange(len(load.elements)), load.tiers] = load.elements
    return (~packets) @ (weights / weights.sum(axis=0))
