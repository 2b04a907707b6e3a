"""Where redundancy goes if the receiver can ask: nothing is sent ahead, what matters is sent again.

The side information is, in any case, and of the packets the first ones in sending order: of a stream with tiers the
most important ones. The expected cost is that of an erasure channel with feedback, p / (1 - p) bytes for each byte that
has to arrive at a loss rate p. That is as little as any code could need, and in bursts far less than a code that is
fixed beforehand.
"""

from collections.abc import Callable, Sequence

import numpy as np

from splatwire.channel import LossModel
from splatwire.errors import InvalidValueError
from splatwire.plan.damage import Offer
from splatwire.plan.outline import Deliveries, draw_losses, outline_transfer
from splatwire.plan.planner import FINAL_TRIALS, MOST_FATES, Plan, check_request, expected
from splatwire.transport.protection import MOST_RESENT, Protection

OVERHEAD = 1.1
"""What is sent again beyond the ideal: reports are late or lost, too. Simulated transfers of four scenes with 20 % of
the reports lost spent 1.02 to 1.05 times the ideal where datagrams were lost at random, 1.10 to 1.18 times in bursts of
20 (worked out from `benchmarks/results/resend.json` and the sizes of the streams)."""


def plan_resending(
    offers: Sequence[Offer],
    loss: LossModel,
    *,
    budget_bytes: float | int,
    most_protection: float = 1.0,
    drawn: int = 6,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Plan:
    """Chooses how many packets are sent again.

    Round trips are not simulated: a deadline must leave some of them after the last byte of the budget.

    Args:
        offers: The stream; or several of the same scene, such as one with tiers and one with a sketch.
        loss: The channel, in datagrams.
        budget_bytes: Bytes that may be sent on average, datagram headers included.
        most_protection: Most bytes on average that are sent again or are there for concealers, as a share of all.
        drawn: Simulated transfers whose pictures say what is expected.
        seed: Of the simulated losses.
        progress: Called with the share of the work that is done.

    Raises:
        InvalidValueError: If a number is out of range, or the side information alone needs more.
    """
    check_request(offers, budget_bytes, most_protection, drawn)
    plans = []
    for number, offer in enumerate(offers):
        packets = len(offer.load.packet_bytes)
        received = draw_losses(loss, max(min(FINAL_TRIALS, MOST_FATES // packets), 1), packets, seed)
        plan = _plan(offer, number, received, float(budget_bytes), most_protection, drawn)
        plans += [plan] if plan is not None else []
        if progress is not None:
            progress((number + 1) / len(offers))
    if not plans:
        raise InvalidValueError(
            f"sending the side information until it arrives needs more than {most_protection:.1%} of all bytes, or "
            f"than the budget of {budget_bytes:,.0f} bytes leaves"
        )
    return max(plans, key=lambda plan: plan.psnr)


def _plan(
    offer: Offer, number: int, received: np.ndarray, budget_bytes: float, most_protection: float, drawn: int
) -> Plan | None:
    """As many packets as the limits allow; None if they do not allow the side information."""
    sizes = outline_transfer(offer.load, Protection(side_repair=0.0)).bytes_by_kind()
    again = OVERHEAD * _odds(received)
    extra = offer.concealment_bytes + offer.preview_bytes
    plain = sizes["side"] + sizes["packets"] - offer.concealment_bytes
    most = min(budget_bytes - plain, plain * most_protection / (1 - most_protection) if most_protection < 1 else np.inf)
    room = most - extra - again * sizes["side"]
    if room < 0:
        return None
    ends = np.cumsum(offer.load.packet_bytes)
    count = int(np.searchsorted(again * ends * (sizes["packets"] / max(ends[-1], 1)), room, side="right"))
    until = count / len(ends)
    packets = received.copy()
    packets[:, :count] = True
    found = expected(offer, Deliveries(np.ones(len(packets), dtype=np.bool_), packets), drawn)
    resent = again * float(offer.load.packet_bytes[:count].sum())
    spent = {"side_protection": round(again * sizes["side"]), "packet_protection": round(resent)}
    total = sum(sizes.values()) + sum(spent.values()) + offer.preview_bytes
    # a limit, however wide, is what makes the sender keep repair symbols of the head that no client has seen
    limit = MOST_RESENT if count == len(ends) else None
    protection = Protection(side_repair=0.0, resend=limit, resend_until=until)
    return Plan(protection, number, found.psnr, 1.0, found.lost, sizes | spent, total, extra)


def _odds(received: np.ndarray) -> float:
    """Bytes sent in vain for each that arrives."""
    rate = 1 - float(received.mean())
    return rate / max(1 - rate, 0.05)
