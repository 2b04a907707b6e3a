"""Planned parity for motion equals the parity that is sent, and never lowers the expected quality."""

import dataclasses
import random

import numpy as np
import pytest

from moving_sequences import moving_frames
from splatwire.bitstream import make_packet
from splatwire.channel import parse_loss
from splatwire.errors import InvalidValueError
from splatwire.planning.sequence.delivery import MotionTransfer, SequenceLoad, delivered, model_motion_transfer
from splatwire.planning.sequence.distortion import SHARES, SequenceDistortion, smoothed
from splatwire.planning.sequence.planner import SequenceVariant, plan_sequence
from splatwire.sequence import SequenceOptions, encode_sequence
from splatwire.sequence.importance import packet_importance, stream_importance
from splatwire.transport import Protection, make_served_stream
from splatwire.transport.protocol.collect import PacketCollector
from splatwire.transport.protocol.messages import Data, Parity, Welcome
from splatwire.transport.protocol.wire import DATA, INIT_SYMBOL

pytestmark = pytest.mark.slow

GROUP = 5
RANDOM, BURSTS = parse_loss("bernoulli:0.15", "datagram"), parse_loss("gilbert:0.1,20", "datagram")


@pytest.fixture(scope="module")
def stream():
    return encode_sequence(moving_frames(6000, 15), SequenceOptions(group_frames=GROUP))[0]


@pytest.fixture(scope="module")
def worth(stream):
    return stream_importance(stream)


@pytest.fixture(scope="module")
def load(stream, worth):
    return SequenceLoad.of(stream, worth)


def variant_of_stream(load, slope: float = 0.01, base: float = 1e-4) -> SequenceVariant:
    """Sequence with a quality that falls in proportion to its lost motion."""
    groups = len(load.groups)
    shares = np.tile([0.0, 1.0], (groups, 1))
    mse = np.tile(np.array([base, base + slope])[None, :, None], (groups, 1, 2))
    return SequenceVariant(load, SequenceDistortion(shares, mse, (GROUP,) * groups))


def schedule_of(way: MotionTransfer) -> list[tuple[int, int, int]]:
    """Kind of each datagram, with parity group and number."""
    return list(zip(way.model.kind.tolist(), way.model.group.tolist(), way.model.symbol.tolist(), strict=True))


def test_importance_of_forged_packets_is_bounded(stream):
    """Forged packets may name tracks that do not exist."""
    plan, rng = stream.manifest.plan, random.Random(3)
    hostile = []
    for packet in stream.packets:
        if not plan.is_keyframe(packet.id.block):
            payloads = (rng.randbytes(rng.randrange(60)) for _ in range(20))
            hostile += [make_packet(packet.id, packet.num_elements, payload) for payload in payloads]
    found = packet_importance(stream.manifest, stream.side_info, hostile, np.ones(10))
    assert all(0 <= worth <= 10 for worth in found)


def test_importance_grows_with_visible_motion(stream, worth):
    plan = stream.manifest.plan
    assert {worth[p.id] for p in stream.packets if plan.is_keyframe(p.id.block)} == {0.0}
    assert sum(worth.values()) > 0


@pytest.mark.parametrize("loss", [RANDOM, BURSTS])
def test_simulated_arrivals_equal_received_packets(stream, load, worth, loss):
    protection = Protection(motion=((0.5, 0.6), (1.0, 0.3), (1.0, 0.0)))
    program = make_served_stream(stream, protection, importance=worth)
    items = [item for item in program.schedule if item[0] != INIT_SYMBOL]
    assert items == schedule_of(model_motion_transfer(load, protection))
    for seed in range(6):
        fates = loss.received(len(items), np.random.Generator(np.random.PCG64(seed)))
        head = (program.stream_id, program.init_segment_bytes, program.init_segment_digest, program.symbol_bytes)
        welcome = Welcome(1, 1, *head, len(program.packets), program.max_packet_bytes, 0, program.parity_ranges)
        collector = PacketCollector(welcome)
        collector.open(stream.manifest)
        for (kind, group, number), arrives in zip(items, fates.tolist(), strict=True):
            if arrives and kind == DATA:
                collector.add(Data(1, 0, number, program.packets[number]))
            elif arrives:
                collector.add_parity(Parity(1, 0, group, number, program.parity[group][number]))
        simulated = delivered(load, protection, loss, seed)
        there = {packet.id for packet in collector.packets}
        assert simulated <= there  # a code that is full without a spare symbol counts as lost
        assert len(there) - len(simulated) <= max(
            code.size for code in model_motion_transfer(load, protection).model.groups
        )


def test_plan_keeps_its_budget_and_matches_the_sent_bytes(stream, load, worth):
    plan = plan_sequence([variant_of_stream(load)], RANDOM, budget_bytes=1.3 * load.num_bytes)
    assert plan.psnr > plan.unprotected
    assert plan.sent_bytes == load.num_bytes + plan.parity_bytes <= 1.3 * load.num_bytes
    program = make_served_stream(stream, plan.protection, importance=worth)
    symbols = sum(len(group) for group in program.parity)
    assert symbols == sum(code.repair for code in model_motion_transfer(load, plan.protection).model.groups) > 0
    richer = plan_sequence([variant_of_stream(load)], RANDOM, budget_bytes=1.6 * load.num_bytes)
    assert richer.psnr >= plan.psnr
    assert sum(richer.lost) < sum(plan.lost)


def test_harmless_losses_get_no_protection(load):
    plan = plan_sequence([variant_of_stream(load, slope=1e-9)], RANDOM, budget_bytes=2 * load.num_bytes)
    assert plan.parity_bytes == 0
    assert plan.psnr == plan.unprotected


def test_planner_chooses_the_better_of_two_qualities(load):
    fine = dataclasses.replace(load, packet_bytes=load.packet_bytes * 5 // 4)
    budget = float(fine.num_bytes)
    for slope in (1e-4, 3e-2):
        coarse_offer, fine_offer = variant_of_stream(load, slope, 1e-4), variant_of_stream(fine, slope, 5e-5)
        plan = plan_sequence([coarse_offer, fine_offer], RANDOM, budget_bytes=budget)
        alone = [plan_sequence([offer], RANDOM, budget_bytes=budget).psnr for offer in (coarse_offer, fine_offer)]
        assert plan.psnr >= max(alone) - 0.02
        assert plan.variant == (1 if slope < 1e-3 else 0)


def test_plan_keeps_its_deadline_and_refuses_one_too_short(load):
    motion = [int(load.packet_bytes[list(group.motion)].sum()) for group in load.groups]
    most = [1.2 * size for size in motion]
    plan = plan_sequence([variant_of_stream(load)], RANDOM, budget_bytes=float("inf"), group_bytes=most)
    for group, size in enumerate(motion):
        way = model_motion_transfer(load, Protection(motion=(plan.protection.motion_of(group),)), group)
        assert size + way.parity_bytes <= 1.2 * size
    with pytest.raises(InvalidValueError, match="too short"):
        plan_sequence(
            [variant_of_stream(load)], RANDOM, budget_bytes=float("inf"), group_bytes=[0.9 * size for size in motion]
        )


def test_error_growth_is_pooled_over_qualities_and_outliers_are_ignored():
    shares, added = np.array([SHARES]), np.array([[0.0, 1.0, 3.0, 6.0, 20.0, 500.0]])[:, :, None] * 1e-5
    true = [SequenceDistortion(shares, 1e-4 / factor + factor * added, (GROUP,)) for factor in (0.5, 1.0, 2.0)]
    drawn = [dataclasses.replace(damage, mse=damage.mse.copy()) for damage in true]
    drawn[0].mse[0, 3] *= 100
    for found, damage in zip(smoothed(drawn), true, strict=True):
        assert np.allclose(found.mse, damage.mse)
    assert np.allclose(smoothed(true[:1])[0].mse, true[0].mse)
