"""Plans retransmission of lost packets (ARQ) within a budget of bytes, instead of forward error correction.

Lost side information is always retransmitted. Lost packets are retransmitted as far as the budget allows.
"""

from collections.abc import Callable, Sequence

import numpy as np

from splatwire.arguments import checked
from splatwire.channel import LossModel
from splatwire.errors import InvalidValueError
from splatwire.planning.distortion import StreamVariant
from splatwire.planning.planner import FINAL_TRIALS, MAX_SIMULATED_DATAGRAMS, ScenePlan, check_request, expected_result
from splatwire.planning.transfer_model import SimulatedTransfers, draw_losses, model_transfer
from splatwire.transport.protocol.protection import MAX_RETRANSMIT_SHARE, Protection

OVERHEAD = 1.1
"""Retransmitted bytes relative to the ideal; more than 1, because receiver reports can be late or lost. In simulated
transfers of four scenes with
20 % of the reports lost, the ratio was 1.02 to 1.05 for random losses, and 1.10 to 1.18 for bursts of 20. The ratios
are computed from `benchmarks/results/retransmission.json` and the sizes of the streams.
"""


@checked
def plan_retransmission(
    variants: Sequence[StreamVariant],
    loss: LossModel,
    *,
    budget_bytes: float | int,
    max_protection: float = 1.0,
    rendered_trials: int = 6,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> ScenePlan:
    """Plans retransmission: chooses the stream variant and the number of packets that may be retransmitted.

    The delay of retransmissions is not simulated.

    Args:
        variants: Variants of the stream, such as one with importance tiers and one with redundant copies.
        loss: Loss model of the channel, in datagrams.
        budget_bytes: Mean bytes that may be sent, datagram headers included.
        max_protection: Maximum mean share of bytes for retransmissions and loss concealment, 0 to 1.
        rendered_trials: Number of simulated transfers that are rendered.
        seed: Seed of the simulated losses.
        progress: Called with the completed fraction.

    Raises:
        InvalidValueError: If a number is out of range, or the side information alone exceeds the limits.
    """
    check_request(variants, budget_bytes, max_protection, rendered_trials)
    plans = []
    for number, variant in enumerate(variants):
        packets = len(variant.load.packet_bytes)
        received = draw_losses(loss, max(min(FINAL_TRIALS, MAX_SIMULATED_DATAGRAMS // packets), 1), packets, seed)
        plan = _plan(variant, number, received, float(budget_bytes), max_protection, rendered_trials)
        plans += [plan] if plan is not None else []
        if progress is not None:
            progress((number + 1) / len(variants))
    if not plans:
        raise InvalidValueError(
            f"sending the side information until it arrives needs more than {max_protection:.1%} of all bytes, or "
            f"than the budget of {budget_bytes:,.0f} bytes leaves"
        )
    return max(plans, key=lambda plan: plan.psnr)


def _plan(
    variant: StreamVariant,
    number: int,
    received: np.ndarray,
    budget_bytes: float,
    max_protection: float,
    rendered_trials: int,
) -> ScenePlan | None:
    """Plans the retransmission for one variant of a stream.

    Args:
        variant: Variant of the stream.
        number: Index of the variant, stored in the plan.
        received: Mask of packets that arrive without retransmission in each of T simulated transfers, bool (T, P).
        budget_bytes: Mean bytes that may be sent, datagram headers included.
        max_protection: Maximum mean share of bytes for retransmissions and loss concealment, 0 to 1.
        rendered_trials: Number of simulated transfers that are rendered.

    Returns:
        The plan; None if the budget is too small for the side information.
    """
    sizes = model_transfer(variant.load, Protection(init_repair=0.0)).bytes_by_kind()
    again = OVERHEAD * _lost_per_received(received)
    extra = variant.concealment_bytes + variant.preview_bytes
    plain = sizes["init_segment"] + sizes["packets"] - variant.concealment_bytes
    most = min(budget_bytes - plain, plain * max_protection / (1 - max_protection) if max_protection < 1 else np.inf)
    room = most - extra - again * sizes["init_segment"]
    if room < 0:
        return None
    ends = np.cumsum(variant.load.packet_bytes)
    count = int(np.searchsorted(again * ends * (sizes["packets"] / max(ends[-1], 1)), room, side="right"))
    until = count / len(ends)
    packets = received.copy()
    packets[:, :count] = True
    result = expected_result(
        variant, SimulatedTransfers(np.ones(len(packets), dtype=np.bool_), packets), rendered_trials
    )
    resent = again * float(variant.load.packet_bytes[:count].sum())
    spent = {"init_protection": round(again * sizes["init_segment"]), "packet_protection": round(resent)}
    total = sum(sizes.values()) + sum(spent.values()) + variant.preview_bytes
    # Any limit, however large, makes the sender keep unsent repair symbols of the init segment.
    limit = MAX_RETRANSMIT_SHARE if count == len(ends) else None
    protection = Protection(init_repair=0.0, retransmit_share=limit, retransmit_until=until)
    return ScenePlan(protection, number, result.psnr, result.lost, total, 1.0, sizes | spent, extra)


def _lost_per_received(received: np.ndarray) -> float:
    """Returns the mean number of lost datagrams per received datagram, at most 20.

    Args:
        received: Mask of received datagrams in simulated transfers, bool.
    """
    rate = 1 - float(received.mean())
    return rate / max(1 - rate, 0.05)
