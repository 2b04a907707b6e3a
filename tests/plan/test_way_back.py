import numpy as np
import pytest

from splatwire.channel import Bernoulli, Nothing, parse_loss
from splatwire.errors import InvalidValueError
from splatwire.plan.damage import Damage, Offer
from splatwire.plan.outline import StreamLoad, outline_transfer
from splatwire.plan.way_back import OVERHEAD, plan_resending
from splatwire.transport.protection import Protection

SHARES = np.array([0.0, 0.2, 1.0])


@pytest.fixture
def offer() -> Offer:
    """A stream of 300 packets in tiers of 30, 70 and 200, and 60 kB of side information."""
    rng = np.random.default_rng(0)
    load = StreamLoad(
        60_000, rng.integers(900, 1150, 300), rng.integers(20, 60, 300), np.repeat([0, 1, 2], [30, 70, 200])
    )
    return Offer(load, Damage(SHARES, np.outer([0.03, 0.006, 0.001], SHARES), 1e-3))


def _bare(offer: Offer) -> dict[str, int]:
    return outline_transfer(offer.load, Protection(side_repair=0.0)).bytes_by_kind()


def test_the_first_packets_are_sent_again_as_far_as_the_limit_goes(offer: Offer) -> None:
    plans = [
        plan_resending([offer], Bernoulli(0.2), budget_bytes=1e7, most_protection=limit) for limit in (0.06, 0.1, 0.5)
    ]
    untils = [plan.protection.resend_until for plan in plans]
    assert 0 < untils[0] < untils[1] < untils[2] == 1.0
    assert plans[0].psnr < plans[1].psnr < plans[2].psnr == pytest.approx(30.0)
    for plan, limit in zip(plans[:2], (0.06, 0.1), strict=True):
        assert limit - 0.004 < plan.protection_share <= limit
        first = round(plan.protection.resend_until * 300)
        again = OVERHEAD * 0.25 * offer.load.packet_bytes[:first].sum()  # of five bytes that leave, four arrive
        assert plan.sizes["packet_protection"] == pytest.approx(again, rel=0.02)
        assert plan.head_arrives == 1.0


def test_a_budget_limits_it_too(offer: Offer) -> None:
    plain = sum(_bare(offer).values())
    plan = plan_resending([offer], parse_loss("gilbert:0.2,8"), budget_bytes=1.1 * plain)
    assert 1.08 * plain < plan.sent_bytes <= 1.1 * plain
    assert plan.lost[0] == 0.0
    assert plan.lost[2] == pytest.approx(0.2, abs=0.02)


def test_without_loss_nothing_is_spent(offer: Offer) -> None:
    plan = plan_resending([offer], Nothing(), budget_bytes=1e7, most_protection=0.01)
    assert plan.protection_share == 0.0
    assert plan.protection.resend_until == 1.0
    assert plan.protection.limits_resending  # what is lost after all is mended by new repair


def test_the_better_stream_is_chosen_and_what_concealers_need_counts(offer: Offer) -> None:
    sketched = Offer(offer.load, Damage(SHARES, offer.damage.mse / 4, 1e-3), concealment_bytes=6_000)
    limited = plan_resending([offer, sketched], Bernoulli(0.2), budget_bytes=1e7, most_protection=0.08)
    assert limited.offer == 1
    alone = plan_resending([offer], Bernoulli(0.2), budget_bytes=1e7, most_protection=0.08)
    assert limited.protection.resend_until < alone.protection.resend_until


def test_mistakes_are_told(offer: Offer) -> None:
    with pytest.raises(InvalidValueError, match=r"needs more than 2\.0% of all bytes"):
        plan_resending([offer], Bernoulli(0.2), budget_bytes=1e7, most_protection=0.02)
    with pytest.raises(InvalidValueError, match="no plan for 1 streams, -1 bytes"):
        plan_resending([offer], Bernoulli(0.2), budget_bytes=-1)
