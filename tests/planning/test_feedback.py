import numpy as np
import pytest

from splatwire.channel import Bernoulli, NoLoss, parse_loss
from splatwire.errors import InvalidValueError
from splatwire.planning.distortion import DistortionModel, StreamVariant
from splatwire.planning.feedback import OVERHEAD, plan_retransmission
from splatwire.planning.transfer_model import StreamLoad, model_transfer
from splatwire.transport.protocol.protection import Protection

SHARES = np.array([0.0, 0.2, 1.0])


@pytest.fixture
def offer() -> StreamVariant:
    """A stream of 300 packets in tiers of 30, 70 and 200, and 60 kB of side information."""
    rng = np.random.default_rng(0)
    load = StreamLoad(
        60_000, rng.integers(900, 1150, 300), rng.integers(20, 60, 300), np.repeat([0, 1, 2], [30, 70, 200])
    )
    return StreamVariant(load, DistortionModel(SHARES, np.outer([0.03, 0.006, 0.001], SHARES), 1e-3))


def _bare(offer: StreamVariant) -> dict[str, int]:
    return model_transfer(offer.load, Protection(init_repair=0.0)).bytes_by_kind()


def test_first_packets_are_retransmitted_within_the_limit(offer: StreamVariant) -> None:
    plans = [
        plan_retransmission([offer], Bernoulli(0.2), budget_bytes=1e7, max_protection=limit)
        for limit in (0.06, 0.1, 0.5)
    ]
    untils = [plan.protection.retransmit_until for plan in plans]
    assert 0 < untils[0] < untils[1] < untils[2] == 1.0
    assert plans[0].psnr < plans[1].psnr < plans[2].psnr == pytest.approx(30.0)
    for plan, limit in zip(plans[:2], (0.06, 0.1), strict=True):
        assert limit - 0.004 < plan.protection_share <= limit
        first = round(plan.protection.retransmit_until * 300)
        again = OVERHEAD * 0.25 * offer.load.packet_bytes[:first].sum()  # four of five sent bytes arrive
        assert plan.sizes["packet_protection"] == pytest.approx(again, rel=0.02)
        assert plan.head_arrives == 1.0


def test_budget_limits_retransmission(offer: StreamVariant) -> None:
    plain = sum(_bare(offer).values())
    plan = plan_retransmission([offer], parse_loss("gilbert:0.2,8"), budget_bytes=1.1 * plain)
    assert 1.08 * plain < plan.sent_bytes <= 1.1 * plain
    assert plan.lost[0] == 0.0
    assert plan.lost[2] == pytest.approx(0.2, abs=0.02)


def test_lossless_channel_needs_no_retransmission(offer: StreamVariant) -> None:
    plan = plan_retransmission([offer], NoLoss(), budget_bytes=1e7, max_protection=0.01)
    assert plan.protection_share == 0.0
    assert plan.protection.retransmit_until == 1.0
    assert plan.protection.limits_retransmission  # new repair symbols replace the remaining losses


def test_better_stream_is_chosen_including_concealment_bytes(offer: StreamVariant) -> None:
    sketched = StreamVariant(
        offer.load, DistortionModel(SHARES, offer.distortion.mse / 4, 1e-3), concealment_bytes=6_000
    )
    limited = plan_retransmission([offer, sketched], Bernoulli(0.2), budget_bytes=1e7, max_protection=0.08)
    assert limited.variant == 1
    alone = plan_retransmission([offer], Bernoulli(0.2), budget_bytes=1e7, max_protection=0.08)
    assert limited.protection.retransmit_until < alone.protection.retransmit_until


def test_invalid_arguments_are_refused(offer: StreamVariant) -> None:
    with pytest.raises(InvalidValueError, match=r"needs more than 2\.0% of all bytes"):
        plan_retransmission([offer], Bernoulli(0.2), budget_bytes=1e7, max_protection=0.02)
    with pytest.raises(InvalidValueError, match="budget_bytes must be positive, not -1"):
        plan_retransmission([offer], Bernoulli(0.2), budget_bytes=-1)
