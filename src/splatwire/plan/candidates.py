"""Protections that a planner tries: side information, parity by tier, order, and what anybody would try first."""

import bisect
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from splatwire.plan.outline import (
    SYMBOLS_TO_SPARE,
    Deliveries,
    Outline,
    StreamLoad,
    head_arrives,
    outline_transfer,
    simulate,
)
from splatwire.transport.protection import Protection

SAFETIES = (None, 0.0, 1.5, 3.0, 6.0, 12.0)
"""Repair of a tier: None, or what replaces the mean loss plus so many standard deviations of random losses; bursts lose
more unevenly, and take the larger ones."""
SIDE_MULTIPLES = (0.0, *(1 + step / 50 for step in range(1, 61)), *(2.2 * 1.1**step for step in range(1, 15)))
"""Repair of the side information as multiples of what replaces the mean loss."""
LEADS = (0.35, 0.7, 1.0)
FINE_SYMBOL_BYTES = 96
"""Symbols of side information this small need less repair against bursts, and have more headers."""
SPREADS = (0.0, 0.6, 1.0)
BEST_SIDES = 2
SAFER = 1.3
"""Where the budget has room, more repair than what suffices in 999 of 1000 transfers: the last one costs 0.02 dB."""
MOST_IN_HEAD = 0.35
"""Most packets, as a share, that are tried in the head object; whole tiers only."""
PLAIN_LEAD = 0.7
MOST_REPAIR = 2.0
_ALIKE_STEPS = 50
_NEARLY = 0.95
"""Where the end of a pass is cut off, repair leaves a little before the cut."""


@dataclass(frozen=True)
class Search:
    """What a plan must keep, and how it is looked for.

    Attributes:
        budget_bytes: Bytes that may be sent.
        most_protection: Most protection as a share of all bytes.
        head_target: Share of transfers in which the side information must arrive.
        concealment_bytes: Bytes of the side information that count as protection.
    """

    budget_bytes: float | int
    most_protection: float | int = 1.0
    head_target: float = 0.999
    concealment_bytes: int = 0

    def allows(self, sizes: dict[str, int]) -> bool:
        """Whether a pass of these sizes (`Outline.bytes_by_kind`) keeps the limit on protection."""
        spent = sizes["side_protection"] + sizes["packet_protection"] + self.concealment_bytes
        return spent <= self.most_protection * sum(sizes.values())


def candidates(load: StreamLoad, traces: np.ndarray, search: Search) -> list[Protection]:
    """Protections worth trying.

    Args:
        load: The stream.
        traces: Simulated fates of datagrams, bool (T, n), longer than any pass.
        search: What must be kept.
    """
    rate = min(1 - float(traces.mean()), 0.95)
    need, counts = rate / (1 - rate), np.bincount(load.tiers, minlength=load.num_tiers).tolist()
    tried = []
    for inside, share in _head_shares(counts):
        repairs = dict.fromkeys(
            (0.0,) * inside + tuple(_repair(s, need, n) for s, n in zip(c, counts[inside:], strict=True))
            for c in _falling(load.num_tiers - inside)
        )
        for side in _sides(load, traces, rate, search, share):
            for repair in repairs:
                protection = replace(side, tier_repair=repair)
                end = _end(search, float(outline_transfer(load, protection).num_bytes.sum()))
                spreads = [spread * end for spread in SPREADS] if load.num_tiers - inside > 1 else [0.0]
                tried += [replace(protection, tier_spread=spread, parity_until=end) for spread in spreads]
    return tried


def largest_head(load: StreamLoad) -> int:
    """Bytes of the largest head object that is tried."""
    return load.head_bytes + int(MOST_IN_HEAD * load.packet_bytes.sum()) + FINE_SYMBOL_BYTES


def _head_shares(counts: Sequence[int]) -> list[tuple[int, float]]:
    """Tiers that may travel in the head object, and what share of all packets they are: none, tier 0, 0 and 1, ..."""
    shares = [(0, 0.0)]
    for inside, packets in enumerate(itertools.accumulate(counts[:-1]), start=1):
        if packets <= MOST_IN_HEAD * sum(counts):
            shares.append((inside, packets / sum(counts)))
    return shares


def plain_candidates(load: StreamLoad, traces: np.ndarray, search: Search) -> dict[str, Protection]:
    """What anybody would try first: the same parity over everything (`whole`), and none on packets (`conceal`).

    Tiers, if there are any, are mixed: sent in one go, the most important one would be at the mercy of one burst.

    Args:
        load: The stream.
        traces: Simulated fates of datagrams, bool (T, n).
        search: The budget and how often the side information must arrive.
    """
    mixed = 1.0 if load.num_tiers > 1 else 0.0

    def alike(step: int) -> Protection:
        repair = step / _ALIKE_STEPS
        return Protection(side_repair=repair, side_lead=1.0, tier_repair=(repair,) * load.num_tiers, tier_spread=mixed)

    def size(step: int) -> int:
        return int(outline_transfer(load, alike(step)).num_bytes.sum())

    steps = range(int(MOST_REPAIR * _ALIKE_STEPS) + 1)
    whole = alike(max(bisect.bisect_right(steps, search.budget_bytes, key=size) - 1, 0))
    rate = min(1 - float(traces.mean()), 0.95)
    return {
        "whole": whole,
        "conceal": _side(load, traces, rate, search, Protection(side_lead=PLAIN_LEAD, tier_spread=mixed)),
    }


def arrival_within(outline: Outline, traces: np.ndarray, budget_bytes: float | int) -> Deliveries:
    """What arrives of the datagrams that leave before the budget is spent.

    Args:
        outline: The transfer.
        traces: Fates of at least as many datagrams, bool (T, n or more).
        budget_bytes: Bytes that may be sent.
    """
    return simulate(outline, _received_within(outline, traces, budget_bytes))


def _received_within(outline: Outline, traces: np.ndarray, budget_bytes: float | int) -> np.ndarray:
    received = traces[:, : len(outline.kind)].copy()
    received[:, outline.sent_within(budget_bytes) :] = False
    return received


def _sides(load: StreamLoad, traces: np.ndarray, rate: float, search: Search, head_share: float) -> list[Protection]:
    """Protections of the head object: the cheapest that arrive often enough, and the cheapest of all with more repair.

    If none arrives often enough, those that come closest to it.
    """
    bare = outline_transfer(load, Protection(side_repair=0.0, head_share=head_share)).bytes_by_kind()
    lead = _end(search, sum(bare.values()) + rate / (1 - rate) * bare["side"])
    starts = [Protection(side_lead=lead * part, side_symbol_bytes=size, head_share=head_share)
              for part in LEADS for size in (None, FINE_SYMBOL_BYTES)]  # fmt: skip
    found = []
    for start in starts:
        side = _side(load, traces, rate, search, start)
        outline = outline_transfer(load, side)
        share = float(head_arrives(outline, _received_within(outline, traces, search.budget_bytes)).mean())
        found.append((-min(share, search.head_target), int(outline.num_bytes.sum()), side))
    best = [side for _, _, side in sorted(found, key=lambda entry: entry[:2])[:BEST_SIDES]]
    return [*best, replace(best[0], side_repair=min(SAFER * best[0].side_repair, MOST_REPAIR))]


def _end(search: Search, pass_bytes: float) -> float:
    """Share of a pass by which whatever must leave has left: 1, or a little before the budget is spent."""
    fit = search.budget_bytes / pass_bytes
    return 1.0 if fit >= 1 else _NEARLY * fit


def _side(load: StreamLoad, traces: np.ndarray, rate: float, search: Search, start: Protection) -> Protection:
    """The least repair with which the side information arrives often enough, or the most that the limit allows."""
    need = rate / (1 - rate)
    repairs = sorted({min(multiple * need, MOST_REPAIR) for multiple in SIDE_MULTIPLES})

    def with_repair(number: int) -> Protection:
        return replace(start, side_repair=repairs[number])

    def too_dear(number: int) -> bool:
        return not search.allows(outline_transfer(load, with_repair(number)).bytes_by_kind())

    def often_enough(number: int) -> bool:
        outline = outline_transfer(load, with_repair(number))
        received = _received_within(outline, traces, search.budget_bytes)
        return float(head_arrives(outline, received).mean()) >= search.head_target

    allowed = range(max(bisect.bisect_left(range(len(repairs)), True, key=too_dear), 1))
    return with_repair(min(bisect.bisect_left(allowed, True, key=often_enough), len(allowed) - 1))


def _falling(tiers: int) -> Sequence[tuple[float | None, ...]]:
    """A safety for each tier that never rises from one to the next."""
    return [
        tuple(SAFETIES[level] for level in combination)
        for combination in itertools.product(range(len(SAFETIES)), repeat=tiers)
        if all(a >= b for a, b in itertools.pairwise(combination))
    ]


def _repair(safety: float | None, need: float, num_packets: int) -> float:
    """Repair symbols for each of some packets."""
    if safety is None or need == 0:
        return 0.0
    deviation = math.sqrt(need * (1 + need) / max(num_packets, 1))
    return min(need + safety * deviation + SYMBOLS_TO_SPARE / max(num_packets, 1), MOST_REPAIR)
