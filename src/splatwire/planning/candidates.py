"""Candidate settings of redundancy (forward error correction and sending order), among which the planner chooses."""

import bisect
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from splatwire.arguments import CheckedFields, checked
from splatwire.planning.transfer_model import (
    SYMBOLS_TO_SPARE,
    SimulatedTransfers,
    StreamLoad,
    TransferModel,
    model_transfer,
    side_info_arrivals,
    simulate,
    transfer_masks,
)
from splatwire.transport.protocol.protection import Protection

SAFETIES = (None, 0.0, 1.5, 3.0, 6.0, 12.0)
"""Candidate numbers of repair symbols of a tier, as standard deviations of random losses above the mean loss; None for
no repair symbols.
Bursts have a larger variance and need the larger margins.
"""
INIT_REPAIR_FACTORS = (0.0, *(1 + step / 50 for step in range(1, 61)), *(2.2 * 1.1**step for step in range(1, 15)))
"""Candidate numbers of repair symbols of the side information, in multiples of the mean loss."""
INIT_UNTIL_FACTORS = (0.35, 0.7, 1.0)
FINE_SYMBOL_BYTES = 96
"""Small symbol size of the side information in bytes: needs less repair against bursts, but has more headers."""
TIER_SPREADS = (0.0, 0.6, 1.0)
NUM_INIT_CANDIDATES = 2
"""Number of settings of the init segment that are combined with all settings of the packets."""
SAFE_REPAIR_FACTOR = 1.3
"""Factor on the number of repair symbols with which 999 of 1000 transfers succeed; used if the budget allows, because
one failure in 1000 costs 0.02 dB."""
MAX_BUNDLED_SHARE = 0.35
"""Maximum fraction of the packets that are bundled in the init segment with the side information; only complete tiers
are bundled.
"""
PLAIN_INIT_UNTIL = 0.7
MAX_REPAIR = 2.0
_EQUAL_REPAIR_STEPS = 50
_NEARLY = 0.95
"""If the budget truncates a transfer, all repair symbols are sent within this fraction of the sent bytes."""


@dataclass(frozen=True)
class PlanConstraints(CheckedFields):
    """Limits that a plan must meet: bytes, share of redundancy, and reliable arrival of the side information.

    Attributes:
        budget_bytes: Maximum number of bytes to send.
        max_protection: Maximum share of redundancy in the sent bytes, 0 to 1.
        init_segment_target: Minimum fraction of the simulated transfers in which the side information arrives, 0 to 1.
        concealment_bytes: Bytes of the side information that serve loss concealment only; they count as redundancy.
    """

    budget_bytes: float | int
    max_protection: float | int = 1.0
    init_segment_target: float = 0.999
    concealment_bytes: int = 0

    def allows(self, sizes: dict[str, int]) -> bool:
        """Returns True if the redundancy of a transfer is within the limit `max_protection`.

        Args:
            sizes: Bytes of the transfer by purpose, from `TransferModel.bytes_by_kind`.
        """
        spent = sizes["init_protection"] + sizes["packet_protection"] + self.concealment_bytes
        return spent <= self.max_protection * sum(sizes.values())


@checked
def candidates(load: StreamLoad, traces: np.ndarray, constraints: PlanConstraints) -> list[Protection]:
    """Returns the settings of redundancy that the planner compares for a static scene.

    Args:
        load: Sizes of the stream's packets.
        traces: Masks of received datagrams in T simulated transfers, bool (T, n).
        constraints: Limits that the plan must meet.
    """
    traces = transfer_masks(traces, "traces", 1)
    rate = min(1 - float(traces.mean()), 0.95)
    need, counts = rate / (1 - rate), np.bincount(load.tiers, minlength=load.num_tiers).tolist()
    tried = []
    for num_bundled, share in _bundled_shares(counts):
        repairs = dict.fromkeys(
            (0.0,) * num_bundled
            + tuple(_repair_per_packet(s, need, n) for s, n in zip(c, counts[num_bundled:], strict=True))
            for c in _margin_assignments(load.num_tiers - num_bundled)
        )
        for start in _init_segment_candidates(load, traces, rate, constraints, share):
            for repair in repairs:
                protection = replace(start, tier_repair=repair)
                end = _spread_end(constraints, float(model_transfer(load, protection).num_bytes.sum()))
                spreads = [spread * end for spread in TIER_SPREADS] if load.num_tiers - num_bundled > 1 else [0.0]
                tried += [replace(protection, tier_spread=spread, parity_until=end) for spread in spreads]
    return tried


@checked
def max_init_segment_bytes(load: StreamLoad) -> int:
    """Returns the approximate size of the largest init segment that the planner considers, in bytes.

    The init segment has the side information, and may also have the most important packets.

    Args:
        load: Sizes of the stream's packets.
    """
    return load.init_segment_bytes + int(MAX_BUNDLED_SHARE * load.packet_bytes.sum()) + FINE_SYMBOL_BYTES


def _bundled_shares(counts: Sequence[int]) -> list[tuple[int, float]]:
    """Lists how many importance tiers the planner may bundle in the init segment.

    The most important tiers are bundled first. The init segment contains all packets of a bundled tier.

    Args:
        counts: Number of packets of each importance tier.

    Returns:
        One pair for each possible number of bundled tiers, ascending: the number, and the share of all packets that are
        bundled, 0 to 1. The first pair is (0, 0).
    """
    shares = [(0, 0.0)]
    for num_bundled, packets in enumerate(itertools.accumulate(counts[:-1]), start=1):
        if packets <= MAX_BUNDLED_SHARE * sum(counts):
            shares.append((num_bundled, packets / sum(counts)))
    return shares


@checked
def baseline_candidates(load: StreamLoad, traces: np.ndarray, constraints: PlanConstraints) -> dict[str, Protection]:
    """Returns two simple settings of redundancy by name, as baselines for the optimised ones.

    * `whole`: the same share of parity for all packets and the side information, as much as the budget allows.
    * `conceal`: redundancy for the side information only; lost packets are left to concealment.

    Args:
        load: Sizes of the stream's packets.
        traces: Masks of received datagrams in T simulated transfers, bool (T, n).
        constraints: Limits that the plan must meet.
    """
    traces = transfer_masks(traces, "traces", 1)
    mixed = 1.0 if load.num_tiers > 1 else 0.0

    def equal_repair(step: int) -> Protection:
        repair = step / _EQUAL_REPAIR_STEPS
        return Protection(init_repair=repair, init_until=1.0, tier_repair=(repair,) * load.num_tiers, tier_spread=mixed)

    def size(step: int) -> int:
        return int(model_transfer(load, equal_repair(step)).num_bytes.sum())

    steps = range(int(MAX_REPAIR * _EQUAL_REPAIR_STEPS) + 1)
    whole = equal_repair(max(bisect.bisect_right(steps, constraints.budget_bytes, key=size) - 1, 0))
    rate = min(1 - float(traces.mean()), 0.95)
    return {
        "whole": whole,
        "conceal": _least_repair(
            load, traces, rate, constraints, Protection(init_until=PLAIN_INIT_UNTIL, tier_spread=mixed)
        ),
    }


@checked
def arrival_within(model: TransferModel, traces: np.ndarray, budget_bytes: float | int) -> SimulatedTransfers:
    """Simulates transfers that stop when a budget of bytes is spent, and returns the data that has arrived by then.

    Args:
        model: Datagrams of a transfer in sending order.
        traces: Masks of received datagrams in T simulated transfers, bool (T, n).
        budget_bytes: Maximum number of bytes to send.
    """
    traces = transfer_masks(traces, "traces", len(model.kind))
    return simulate(model, _received_within(model, traces, budget_bytes))


def _received_within(model: TransferModel, traces: np.ndarray, budget_bytes: float | int) -> np.ndarray:
    received = traces[:, : len(model.kind)].copy()
    received[:, model.sent_within(budget_bytes) :] = False
    return received


def _init_segment_candidates(
    load: StreamLoad, traces: np.ndarray, rate: float, constraints: PlanConstraints, bundled_share: float
) -> list[Protection]:
    """Returns the settings of redundancy that the planner compares for the init segment (side information).

    Args:
        load: Sizes of the stream's packets.
        traces: Masks of received datagrams in T simulated transfers, bool (T, n).
        rate: Mean loss rate of datagrams.
        constraints: Limits that the plan must meet.
        bundled_share: Fraction of the packets that are bundled in the init segment.
    """
    bare = model_transfer(load, Protection(init_repair=0.0, bundled_share=bundled_share)).bytes_by_kind()
    until = _spread_end(constraints, sum(bare.values()) + rate / (1 - rate) * bare["init_segment"])
    starts = [Protection(init_until=until * part, init_symbol_bytes=size, bundled_share=bundled_share)
              for part in INIT_UNTIL_FACTORS for size in (None, FINE_SYMBOL_BYTES)]  # fmt: skip
    protections = []
    for start in starts:
        protection = _least_repair(load, traces, rate, constraints, start)
        model = model_transfer(load, protection)
        share = float(side_info_arrivals(model, _received_within(model, traces, constraints.budget_bytes)).mean())
        protections.append((-min(share, constraints.init_segment_target), int(model.num_bytes.sum()), protection))
    best = [protection for _, _, protection in sorted(protections, key=lambda entry: entry[:2])[:NUM_INIT_CANDIDATES]]
    return [*best, replace(best[0], init_repair=min(SAFE_REPAIR_FACTOR * best[0].init_repair, MAX_REPAIR))]


def _spread_end(constraints: PlanConstraints, pass_bytes: float) -> float:
    """Returns the fraction of a transfer, counted from its start, over which repair symbols are distributed, 0 to 1.

    The value is 1 if the budget suffices for the complete transfer. Otherwise, repair symbols end a little before the
    budget is spent.

    Args:
        constraints: Limits of the plan, which contain the budget.
        pass_bytes: Size of the complete transfer in bytes.
    """
    fit = constraints.budget_bytes / pass_bytes
    return 1.0 if fit >= 1 else _NEARLY * fit


def _least_repair(
    load: StreamLoad, traces: np.ndarray, rate: float, constraints: PlanConstraints, start: Protection
) -> Protection:
    """Chooses the smallest amount of parity with which the side information arrives as often as required.

    If no amount within the limits suffices, the largest amount within the limits is chosen.

    Args:
        load: Sizes of the stream's packets.
        traces: Masks of received datagrams in T simulated transfers, bool (T, n).
        rate: Mean loss rate of datagrams.
        constraints: Limits that the plan must meet, with the required fraction of transfers.
        start: Settings of redundancy; `init_repair` is replaced.

    Returns:
        The settings `start` with the chosen `init_repair`.
    """
    need = rate / (1 - rate)
    repairs = sorted({min(multiple * need, MAX_REPAIR) for multiple in INIT_REPAIR_FACTORS})

    def with_repair(number: int) -> Protection:
        return replace(start, init_repair=repairs[number])

    def exceeds_limit(number: int) -> bool:
        return not constraints.allows(model_transfer(load, with_repair(number)).bytes_by_kind())

    def often_enough(number: int) -> bool:
        model = model_transfer(load, with_repair(number))
        received = _received_within(model, traces, constraints.budget_bytes)
        return float(side_info_arrivals(model, received).mean()) >= constraints.init_segment_target

    allowed = range(max(bisect.bisect_left(range(len(repairs)), True, key=exceeds_limit), 1))
    return with_repair(min(bisect.bisect_left(allowed, True, key=often_enough), len(allowed) - 1))


def _margin_assignments(tiers: int) -> Sequence[tuple[float | None, ...]]:
    """Lists the combinations of safety margins that the planner compares, one margin for each importance tier.

    Redundancy covers the mean number of lost packets and a safety margin. A more important tier never has a smaller
    margin.

    Args:
        tiers: Number of tiers.

    Returns:
        Margins of the tiers, most important first, in standard deviations of the number of lost packets; None for a
        tier without redundancy.
    """
    return [
        tuple(SAFETIES[level] for level in combination)
        for combination in itertools.product(range(len(SAFETIES)), repeat=tiers)
        if all(a >= b for a, b in itertools.pairwise(combination))
    ]


def _repair_per_packet(safety: float | None, need: float, num_packets: int) -> float:
    """Returns the number of repair symbols per packet that cover the mean loss and a safety margin.

    Args:
        safety: Margin in standard deviations of the number of lost packets; None for no parity.
        need: Number of repair symbols per packet that covers the mean loss, without a margin.
        num_packets: Number of packets that share the parity.
    """
    if safety is None or need == 0:
        return 0.0
    deviation = math.sqrt(need * (1 + need) / max(num_packets, 1))
    return min(need + safety * deviation + SYMBOLS_TO_SPARE / max(num_packets, 1), MAX_REPAIR)
