import dataclasses

import numpy as np
import pytest

from splatwire.channel import Bernoulli, NoLoss, parse_loss
from splatwire.errors import InvalidValueError
from splatwire.planning.candidates import PlanConstraints, arrival_within, baseline_candidates
from splatwire.planning.distortion import BLANK_MSE, BLANK_PSNR, DistortionModel, StreamVariant, lost_fractions
from splatwire.planning.planner import draw_transfer_losses, plan_protection
from splatwire.planning.transfer_model import StreamLoad, TransferModel, draw_losses, model_transfer, simulate
from splatwire.transport.protocol.protection import Protection
from splatwire.transport.protocol.wire import DATA, INIT_SYMBOL, PARITY

pytestmark = pytest.mark.slow

SHARES = np.array([0.0, 0.2, 1.0])


@pytest.fixture
def load() -> StreamLoad:
    """A stream of 150 packets, a tenth of them in tier 0, and 30 kB of side information."""
    rng = np.random.default_rng(0)
    return StreamLoad(
        30_000, rng.integers(900, 1150, 150), rng.integers(20, 60, 150), np.repeat([0, 1, 2], [15, 35, 100])
    )


@pytest.fixture
def damage() -> DistortionModel:
    return DistortionModel(SHARES, np.outer([0.03, 0.006, 0.001], SHARES), 1e-3)


def _budget(load: StreamLoad, factor: float) -> float:
    return factor * float(model_transfer(load, Protection(init_repair=0.0)).num_bytes.sum())


def test_lossless_transfer_delivers_everything(load: StreamLoad) -> None:
    model = model_transfer(load, Protection(init_repair=0.0))
    arrival = simulate(model, draw_losses(NoLoss(), 3, len(model.kind), 0))
    assert arrival.side_info.all()
    assert arrival.packets.all()


def test_transfer_model_contains_each_datagram_once(load: StreamLoad) -> None:
    model = model_transfer(load, Protection(init_repair=0.5, tier_repair=(0.5, 0.25)))
    assert sorted(model.symbol[model.kind == DATA]) == list(range(150))
    assert (model.kind == PARITY).sum() == 8 + 9
    source = sum(model.source_block_sizes)
    assert (model.kind == INIT_SYMBOL).sum() == source + round(0.5 * source)
    assert sum(model.bytes_by_kind().values()) == model.num_bytes.sum()


def _arrivals_by_hand(model: TransferModel, received: np.ndarray) -> tuple[bool, list[bool]]:
    """Received packets, counted datagram by datagram with sets, to compare with the arrays of `simulate`."""
    head: dict[int, set[int]] = {}
    packets, parity = set(), [0] * len(model.groups)
    for kind, group, symbol, ok in zip(model.kind, model.group, model.symbol, received, strict=True):
        if not ok:
            continue
        if kind == INIT_SYMBOL:
            head.setdefault(int(group), set()).add(int(symbol))
        elif kind == DATA:
            packets.add(int(symbol))
        else:
            parity[group] += 1
    packets |= set(range(model.num_bundled))
    recovered = set(packets)
    for number, group in enumerate(model.groups):
        members = {group.packet_of(n) for n in range(group.size)}
        if len(members & packets) + parity[number] > group.size:
            recovered |= members
    complete = all(
        set(range(size)) <= head.get(source_block, set()) or len(head.get(source_block, set())) > size
        for source_block, size in enumerate(model.source_block_sizes)
    )
    return complete, [place in recovered for place in range(model.num_packets)]


@pytest.mark.parametrize("share", [0.0, 0.1, 0.2])
@pytest.mark.parametrize("loss", ["bernoulli:0.25", "gilbert:0.2,8"])
def test_simulation_equals_explicit_counting(load: StreamLoad, loss: str, share: float) -> None:
    model = model_transfer(load, Protection(init_repair=0.36, tier_repair=(0.45, 0.3), bundled_share=share))
    received = draw_losses(parse_loss(loss), 40, len(model.kind), 1)
    arrival = simulate(model, received)
    outcomes = [_arrivals_by_hand(model, row) for row in received]
    assert arrival.side_info.tolist() == [head for head, _ in outcomes]
    assert arrival.packets.tolist() == [packets for _, packets in outcomes]
    assert len({head for head, _ in outcomes}) == 2  # both outcomes occurred


def test_shares_of_lost_anchors_follow_the_lost_packets(load: StreamLoad) -> None:
    packets = np.ones((2, 150), dtype=np.bool_)
    packets[0, :15] = False
    packets[1, 15] = False
    lost = lost_fractions(load, packets)
    assert lost[0].tolist() == [1.0, 0.0, 0.0]
    assert lost[1, 1] == pytest.approx(load.elements[15] / load.elements[15:50].sum())


def test_larger_budget_is_never_worse_and_protects_important_tiers_first(
    load: StreamLoad, damage: DistortionModel
) -> None:
    plans = [
        plan_protection([StreamVariant(load, damage)], Bernoulli(0.2), budget_bytes=_budget(load, factor), trials=40)
        for factor in (1.1, 1.3, 1.7)
    ]
    assert plans[0].psnr <= plans[1].psnr + 0.05
    assert plans[1].psnr <= plans[2].psnr + 0.05
    assert plans[2].lost == (0.0, 0.0, 0.0)
    for plan in plans:
        inside = round(plan.protection.bundled_share * 150)
        assert inside in (0, 15, 50)  # whole tiers
        repair = plan.protection.tier_repair[(0, 15, 50).index(inside) :]
        assert list(repair) == sorted(repair, reverse=True)
        assert plan.lost[0] < 0.02  # without parity a fifth would be lost
    assert plans[0].sent_bytes <= _budget(load, 1.1)


def test_lossless_channel_gets_no_protection(load: StreamLoad, damage: DistortionModel) -> None:
    plan = plan_protection([StreamVariant(load, damage)], NoLoss(), budget_bytes=_budget(load, 2.0), trials=5)
    assert plan.protection_share == 0.0
    assert plan.psnr == pytest.approx(30.0)


def test_a_limit_on_protection_is_kept(load: StreamLoad, damage: DistortionModel) -> None:
    plan = plan_protection(
        [StreamVariant(load, damage)], Bernoulli(0.2), budget_bytes=_budget(load, 2.0), trials=20, max_protection=0.12
    )
    assert 0 < plan.protection_share <= 0.12


def test_protection_limit_also_binds_side_information(load: StreamLoad, damage: DistortionModel) -> None:
    plan = plan_protection(
        [StreamVariant(load, damage)], Bernoulli(0.3), budget_bytes=1e7, trials=5, max_protection=0.02
    )
    assert plan.protection_share <= 0.02
    assert plan.head_arrives < 0.999


def test_budget_below_the_side_information_gives_the_blank_quality(load: StreamLoad, damage: DistortionModel) -> None:
    plan = plan_protection([StreamVariant(load, damage)], Bernoulli(0.2), budget_bytes=15_000, trials=20)
    assert plan.head_arrives == 0.0
    assert plan.psnr == pytest.approx(-10 * np.log10(BLANK_MSE))


def test_preview_counts_as_bytes_and_as_the_lowest_quality(load: StreamLoad, damage: DistortionModel) -> None:
    budget = _budget(load, 1.3)
    shown = StreamVariant(load, damage, concealment_bytes=450, preview_bytes=500, blank_psnr=20.0)
    for limit, loss in ((1.0, 0.0), (0.04, 0.2)):
        with_preview, plain = (
            plan_protection([offer], Bernoulli(loss), budget_bytes=budget, trials=20, max_protection=limit)
            for offer in (shown, StreamVariant(load, damage))
        )
        assert with_preview.concealment_bytes == 950
        assert with_preview.protection_share <= limit
        assert with_preview.sent_bytes <= budget
        if loss:
            assert plain.head_arrives < 0.999
            assert with_preview.psnr > plain.psnr
    nothing = plan_protection([shown], Bernoulli(0.2), budget_bytes=15_000, trials=20)
    assert nothing.psnr == pytest.approx(20.0)
    with pytest.raises(InvalidValueError, match="preview"):
        StreamVariant(load, damage, preview_bytes=-1)


def test_equal_seeds_give_equal_plans(load: StreamLoad, damage: DistortionModel) -> None:
    plans = [
        plan_protection(
            [StreamVariant(load, damage)], Bernoulli(0.1), budget_bytes=_budget(load, 1.2), trials=10, seed=3
        )
        for _ in range(2)
    ]
    assert plans[0] == plans[1]


def test_invalid_arguments_are_refused(load: StreamLoad, damage: DistortionModel) -> None:
    with pytest.raises(InvalidValueError, match="damage of 2 tiers, and the stream has 3"):
        StreamVariant(load, dataclasses.replace(damage, mse=damage.mse[:2]))
    with pytest.raises(InvalidValueError, match="budget_bytes must be positive, not -1"):
        plan_protection([StreamVariant(load, damage)], Bernoulli(0.1), budget_bytes=-1)
    with pytest.raises(InvalidValueError, match="ascend from 0"):
        DistortionModel(np.array([0.1, 0.2]), np.zeros((1, 2)), 1e-3)


def test_distortion_of_measured_loss_combinations_is_exact() -> None:
    damage = DistortionModel(SHARES, np.array([[0.0, 0.010, 0.05], [0.0, 0.004, 0.02], [0.0, 0.002, 0.01]]), 1e-3)
    lost = np.array([[0.2, 0.2, 0.2], [0.0, 0.0, 0.2], [0.0, 0.2, 0.2], [0.0, 0.2, 1.0], [0.0, 0.0, 0.0]])
    added = 10 ** (-damage.psnr(lost) / 10) - 1e-3
    assert added == pytest.approx([0.010, 0.002, 0.004, 0.004 + 0.010 - 0.002, 0.0], abs=1e-9)


def test_close_plans_are_decided_by_rendering(load: StreamLoad, damage: DistortionModel) -> None:
    seen = []

    def picture(packets: np.ndarray) -> float:
        seen.append(packets)
        lost = 1 - packets.mean()
        return 30.0 - 10.0 * lost  # independent of the curves, all packets are equally important

    budget = _budget(load, 1.15)
    curves = plan_protection([StreamVariant(load, damage)], Bernoulli(0.1), budget_bytes=budget, trials=20)
    drawn = plan_protection(
        [StreamVariant(load, damage, picture)], Bernoulli(0.1), budget_bytes=budget, trials=20, rendered_trials=3
    )
    assert 0 < len(seen) <= 6 * 3
    assert drawn.psnr != curves.psnr
    assert drawn.psnr == pytest.approx(30.0 - 10.0 * np.average(drawn.lost, weights=[15, 35, 100]), abs=0.5)


def test_best_of_several_streams_is_chosen(load: StreamLoad, damage: DistortionModel) -> None:
    worse = dataclasses.replace(damage, base_mse=2e-3)
    offers = [StreamVariant(load, worse), StreamVariant(load, damage), StreamVariant(load, worse)]
    plan = plan_protection(offers, Bernoulli(0.1), budget_bytes=_budget(load, 1.3), trials=10)
    assert plan.variant == 1


def test_concealment_bytes_count_as_protection(load: StreamLoad, damage: DistortionModel) -> None:
    offer = StreamVariant(load, damage, concealment_bytes=10_000)
    plan = plan_protection([offer], NoLoss(), budget_bytes=_budget(load, 2.0), trials=5)
    assert plan.protection_bytes == 10_000
    with pytest.raises(InvalidValueError, match=r"below 1\.0%"):
        plan_protection([offer], NoLoss(), budget_bytes=1e7, trials=5, max_protection=0.01)
    with pytest.raises(InvalidValueError, match="in an init segment of 30000"):
        StreamVariant(load, damage, concealment_bytes=30_001)


def test_baselines_are_compared_with_the_planned_allocations(load: StreamLoad, damage: DistortionModel) -> None:
    """If all packets are equally important, equal parity for all is the best plan."""
    flat = dataclasses.replace(load, tiers=np.zeros(150, dtype=np.int64))
    alike = DistortionModel(SHARES, damage.mse[:1], 1e-3)
    budget = _budget(flat, 1.35)
    traces = draw_transfer_losses([StreamVariant(flat, alike)], Bernoulli(0.2), 200, 0)
    plain = baseline_candidates(flat, traces, PlanConstraints(budget))
    model = model_transfer(flat, plain["whole"])
    assert 0.97 * budget < model.num_bytes.sum() <= budget
    assert plain["conceal"].tier_repair == ()
    assert arrival_within(model_transfer(flat, plain["conceal"]), traces, budget).side_info.all()
    plan = plan_protection([StreamVariant(flat, alike)], Bernoulli(0.2), budget_bytes=budget, trials=40)
    whole = arrival_within(model, traces, budget)
    psnr = np.where(whole.side_info, alike.psnr(lost_fractions(flat, whole.packets)), BLANK_PSNR).mean()
    assert plan.psnr >= psnr - 0.05


def test_baseline_is_chosen_without_a_clear_gain_of_another_plan(load: StreamLoad) -> None:
    """A small difference of rendered quality does not justify leaving the plain plan."""
    flat = dataclasses.replace(load, tiers=np.zeros(150, dtype=np.int64))
    tiered_mse = np.outer([3e-3, 6e-4, 1e-4], SHARES)

    def offers(gain: float) -> list[StreamVariant]:
        without_tiers = DistortionModel(SHARES, tiered_mse[:1], 1e-3)
        with_tiers = DistortionModel(SHARES, tiered_mse, 1e-3)
        return [
            StreamVariant(flat, without_tiers, lambda packets: 25.0),
            StreamVariant(load, with_tiers, lambda packets: 25.0 + gain),
        ]

    budget = _budget(flat, 1.1)
    near, far = (plan_protection(offers(gain), Bernoulli(0.2), budget_bytes=budget, trials=20) for gain in (0.1, 0.5))
    traces = draw_transfer_losses(offers(0.0), Bernoulli(0.2), 1000, 0)
    assert near.variant == 0
    assert near.protection == baseline_candidates(flat, traces, PlanConstraints(budget))["conceal"]
    assert far.variant == 1


def test_tiers_are_interleaved_over_the_transfer(load: StreamLoad) -> None:
    plain, half, mixed = (
        model_transfer(load, Protection(init_until=0.4, tier_repair=(0.4,), tier_spread=spread))
        for spread in (0.0, 0.5, 1.0)
    )

    def last_of_tier_0(model: TransferModel) -> float:
        return float(np.flatnonzero((model.kind == DATA) & (model.symbol < 15)).max() / len(model.kind))

    assert last_of_tier_0(plain) < 0.2 < 0.45 < last_of_tier_0(half) < 0.85 < 0.95 < last_of_tier_0(mixed)
    for model in (half, mixed):
        assert model.bytes_by_kind() == plain.bytes_by_kind()
        assert sorted(model.symbol[model.kind == DATA]) == list(range(150))
