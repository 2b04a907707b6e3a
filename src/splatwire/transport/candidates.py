"""Protections that a planner tries: side information, parity by tier, order, and what anybody would try first."""

import bisect
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from splatwire.transport.outline import (
    SPARE_SYMBOLS,
    Arrival,
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
SIDE_MULTIPLES = (0.0, *(1 + step / 20 for step in range(1, 21)), 2.2, 2.5, 3.0, 3.6, 4.5, 6.0, 8.0)
"""Repair of the side information as multiples of what replaces the mean loss."""
LEADS = (0.35, 0.7, 1.0)
FINE_SYMBOL_BYTES = 96
"""Symbols of side information this small need less repair against bursts, and have more headers."""
SPREADS = (0.0, 0.6, 1.0)
BEST_SIDES = 2
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
    repairs = dict.fromkeys(tuple(_repair(s, need, n) for s, n in zip(c, counts, strict=True))
                            for c in _falling(load.num_tiers))  # fmt: skip
    tried = []
    for side in _sides(load, traces, rate, search):
        for repair in repairs:
            protection = replace(side, tier_repair=repair)
            end = _end(search, float(outline_transfer(load, protection).num_bytes.sum()))
            spreads = [spread * end for spread in SPREADS] if load.num_tiers > 1 else [0.0]
            tried += [replace(protection, tier_spread=spread, parity_until=end) for spread in spreads]
    return tried


def plain_candidates(load: StreamLoad, traces: np.ndarray, search: Search) -> dict[str, Protection]:
    """What anybody would try first: the same parity over everything (`whole`), and none on packets (`conceal`).

    Args:
        load: The stream.
        traces: Simulated fates of datagrams, bool (T, n).
        search: The budget and how often the side information must arrive.
    """

    def alike(step: int) -> Protection:
        repair = step / _ALIKE_STEPS
        return Protection(side_repair=repair, side_lead=1.0, tier_repair=(repair,) * load.num_tiers)

    def size(step: int) -> int:
        return int(outline_transfer(load, alike(step)).num_bytes.sum())

    steps = range(int(MOST_REPAIR * _ALIKE_STEPS) + 1)
    whole = alike(max(bisect.bisect_right(steps, search.budget_bytes, key=size) - 1, 0))
    rate = min(1 - float(traces.mean()), 0.95)
    return {"whole": whole, "conceal": _side(load, traces, rate, search, Protection(side_lead=PLAIN_LEAD))}


def arrival_within(outline: Outline, traces: np.ndarray, budget_bytes: float | int) -> Arrival:
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


def _sides(load: StreamLoad, traces: np.ndarray, rate: float, search: Search) -> list[Protection]:
    """Protections of the side information: the cheapest that arrive often enough; if none does, the closest to it."""
    bare = float(outline_transfer(load, Protection(side_repair=0.0)).num_bytes.sum())
    lead = _end(search, bare + rate / (1 - rate) * load.head_bytes)
    starts = [Protection(side_lead=lead * part, side_symbol_bytes=size)
              for part in LEADS for size in (None, FINE_SYMBOL_BYTES)]  # fmt: skip
    found = []
    for start in starts:
        side = _side(load, traces, rate, search, start)
        outline = outline_transfer(load, side)
        share = float(head_arrives(outline, _received_within(outline, traces, search.budget_bytes)).mean())
        found.append((-min(share, search.head_target), int(outline.num_bytes.sum()), side))
    return [side for _, _, side in sorted(found, key=lambda entry: entry[:2])[:BEST_SIDES]]


def _end(search: Search, pass_bytes: float) -> float:
    """Share of a pass by which whatever must leave has left: 1, or a little before the budget is spent."""
    fit = search.budget_bytes / pass_bytes
    return 1.0 if fit >= 1 else _NEARLY * fit


def _side(load: StreamLoad, traces: np.ndarray, rate: float, search: Search, start: Protection) -> Protection:
    """The least repair with which the side information arrives often enough, or the most that the limit allows."""
    need, best = rate / (1 - rate), replace(start, side_repair=0.0)
    for multiple in SIDE_MULTIPLES:
        protection = replace(best, side_repair=min(multiple * need, MOST_REPAIR))
        outline = outline_transfer(load, protection)
        if not search.allows(outline.bytes_by_kind()):
            break
        best = protection
        received = _received_within(outline, traces, search.budget_bytes)
        if float(head_arrives(outline, received).mean()) >= search.head_target:
            break
    return best


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
    return min(need + safety * deviation + SPARE_SYMBOLS / max(num_packets, 1), MOST_REPAIR)
