"""Where redundancy pays: splits a budget of bytes between side information, tiers of importance and nothing at all.

The sender knows what each tier is worth (`Damage`, measured by drawing the scene without it) and what the channel does
(a loss model). The planner tries protections, simulates transfers of each, and keeps the one with the best picture.
What leaves after the budget is spent is never sent: the same cut stands for a deadline at a given rate.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from splatwire.errors import InvalidValueError
from splatwire.transport.outline import (
    SPARE_SYMBOLS,
    Arrival,
    LossProcess,
    Outline,
    StreamLoad,
    draw_losses,
    outline_transfer,
    simulate,
)
from splatwire.transport.program import Protection

BLANK_MSE = 0.25
"""What is seen without side information: nothing."""
SAFETIES = (None, 0.0, 1.5, 3.0, 6.0, 12.0)
"""Repair of a tier: None, or what replaces the mean loss plus so many standard deviations of random losses; bursts lose
more unevenly, and take the larger ones."""
SIDE_MULTIPLES = (0.0, *(1 + step / 20 for step in range(1, 21)), 2.2, 2.5, 3.0, 3.6, 4.5, 6.0, 8.0)
"""Repair of the side information as multiples of what replaces the mean loss."""
LEADS = (0.35, 0.7, 1.0)
FINE_SYMBOL_BYTES = 96
"""Symbols of side information this small need less repair against bursts, and have more headers."""


@dataclass(frozen=True, eq=False)
class Damage:
    """What losing anchors does to the picture, after concealment.

    Attributes:
        shares: Lost shares of a tier at which the damage was measured, ascending from 0, float64 (S).
        mse: Mean squared error that the loss of this share of each tier adds, float64 (T, S).
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
        added = [np.interp(lost[:, t], self.shares, self.mse[t]) for t in range(len(self.mse))]
        return -10 * np.log10(self.base_mse + np.maximum(np.sum(added, axis=0), 0))


@dataclass(frozen=True)
class Plan:
    """A protection and what is expected of it.

    Attributes:
        protection: Where redundancy goes.
        psnr: Mean over simulated transfers, decibels.
        head_arrives: Share of the transfers in which the side information arrives.
        lost: Mean share of each tier's anchors that is lost.
        sizes: Bytes of a whole pass by what they are for.
        sent_bytes: Bytes that are sent within the budget.
    """

    protection: Protection
    psnr: float
    head_arrives: float
    lost: tuple[float, ...]
    sizes: dict[str, int]
    sent_bytes: int

    @property
    def protection_share(self) -> float:
        """Protection of side information and packets as a share of all bytes."""
        spent = self.sizes["side_protection"] + self.sizes["packet_protection"]
        return spent / max(sum(self.sizes.values()), 1)


def plan_protection(
    load: StreamLoad,
    damage: Damage,
    loss: LossProcess,
    *,
    budget_bytes: float | int,
    trials: int = 100,
    seed: int = 0,
    most_protection: float = 1.0,
    head_target: float = 0.999,
    progress: Callable[[float], None] | None = None,
) -> Plan:
    """Chooses the protection with the best expected picture.

    Args:
        load: The stream.
        damage: What losses of each tier cost.
        loss: The channel, in datagrams.
        budget_bytes: Bytes that may be sent, datagram headers included; a deadline is its time times the rate.
        trials: Simulated transfers of each protection of the packets; ten times as many decide on the side information.
        seed: Of the simulated losses, which all candidates share.
        most_protection: Most protection as a share of all bytes.
        head_target: Share of transfers in which the side information must arrive, if any candidate gets there.
        progress: Called with the share of candidates that is done.

    Raises:
        InvalidValueError: If tiers and damage do not fit, or a number is out of range.
    """
    if len(damage.mse) != load.num_tiers:
        raise InvalidValueError(f"damage of {len(damage.mse)} tiers, and the stream has {load.num_tiers}")
    if not (budget_bytes > 0 and trials > 0 and 0 < most_protection <= 1):
        raise InvalidValueError(
            f"no plan for {budget_bytes} bytes, {trials} trials and at most {most_protection:.1%} of protection"
        )
    bare = outline_transfer(load, Protection(side_repair=0.0))
    traces = draw_losses(loss, 10 * trials, 3 * len(bare.kind) + load.head_bytes // 32, seed)
    rate = min(1 - float(traces.mean()), 0.95)
    limits = _Limits(most_protection, head_target)
    starts = [
        Protection(side_lead=lead, side_symbol_bytes=size) for lead in LEADS for size in (None, FINE_SYMBOL_BYTES)
    ]
    sides = [_side_protection(load, traces, rate, budget_bytes, start, limits) for start in starts]
    candidates = _candidates(sides, np.bincount(load.tiers, minlength=load.num_tiers), rate)
    plans: list[Plan] = []
    for tried, candidate in enumerate(candidates):
        outline = outline_transfer(load, candidate)
        plan = _judge(outline, candidate, load, damage, traces[:trials], budget_bytes)
        if plan.protection_share <= most_protection:
            plans.append(plan)
        if progress:
            progress((tried + 1) / len(candidates))
    return _best(plans, head_target)


def arrival_within(outline: Outline, traces: np.ndarray, budget_bytes: float | int) -> Arrival:
    """What arrives of the datagrams that leave before the budget is spent.

    Args:
        outline: The transfer.
        traces: Fates of at least as many datagrams, bool (T, n or more).
        budget_bytes: Bytes that may be sent.
    """
    received = traces[:, : len(outline.kind)].copy()
    received[:, outline.sent_within(budget_bytes) :] = False
    return simulate(outline, received)


def lost_shares(load: StreamLoad, packets: np.ndarray) -> np.ndarray:
    """Share of each tier's anchors that is not there.

    Args:
        load: The stream.
        packets: Which packets are there, bool (T, P).

    Returns:
        Float64 (T, tiers).
    """
    weights = np.zeros((len(load.anchors), load.num_tiers))
    weights[np.arange(len(load.anchors)), load.tiers] = load.anchors
    return (~packets) @ (weights / weights.sum(axis=0))


def _side_protection(
    load: StreamLoad, traces: np.ndarray, rate: float, budget_bytes: float | int, start: Protection, limits: "_Limits"
) -> Protection:
    """The least repair with which the side information arrives often enough, or the most that the limit allows."""
    need, best = rate / (1 - rate), replace(start, side_repair=0.0)
    for multiple in SIDE_MULTIPLES:
        protection = replace(best, side_repair=min(multiple * need, 2.0))
        outline = outline_transfer(load, protection)
        sizes = outline.bytes_by_kind()
        if sizes["side_protection"] > limits.most_protection * sum(sizes.values()):
            break
        best = protection
        if float(arrival_within(outline, traces, budget_bytes).head.mean()) >= limits.head_target:
            break
    return best


class _Limits(NamedTuple):
    """What a plan must keep; see `plan_protection`."""

    most_protection: float
    head_target: float


def _candidates(sides: Sequence[Protection], num_packets: np.ndarray, rate: float) -> list[Protection]:
    """Protections of the side information times repair of the tiers, whose safety never rises from one to the next."""
    need = rate / (1 - rate)
    levels = range(len(SAFETIES))
    falling = [
        tuple(_repair(SAFETIES[level], need, int(count)) for level, count in zip(combination, num_packets, strict=True))
        for combination in itertools.product(levels, repeat=len(num_packets))
        if all(a >= b for a, b in itertools.pairwise(combination))
    ]
    return [replace(side, tier_repair=repair) for side in sides for repair in dict.fromkeys(falling)]


def _repair(safety: float | None, need: float, num_packets: int) -> float:
    """Repair symbols for each of some packets."""
    if safety is None or need == 0:
        return 0.0
    deviation = math.sqrt(need * (1 + need) / max(num_packets, 1))
    return min(need + safety * deviation + SPARE_SYMBOLS / max(num_packets, 1), 2.0)


def _judge(
    outline: Outline, protection: Protection, load: StreamLoad, damage: Damage, traces: np.ndarray,
    budget_bytes: float | int,
) -> Plan:  # fmt: skip
    arrival = arrival_within(outline, traces, budget_bytes)
    lost = lost_shares(load, arrival.packets)
    blank = -10 * np.log10(BLANK_MSE)
    psnr = np.where(arrival.head, damage.psnr(lost), blank)
    sent = int(outline.num_bytes[: outline.sent_within(budget_bytes)].sum())
    mean_lost = tuple(float(share) for share in lost.mean(axis=0))
    return Plan(protection, float(psnr.mean()), float(arrival.head.mean()), mean_lost, outline.bytes_by_kind(), sent)


def _best(plans: Sequence[Plan], head_target: float) -> Plan:
    safe = [plan for plan in plans if plan.head_arrives >= head_target]
    return max(safe or plans, key=lambda plan: plan.psnr)
