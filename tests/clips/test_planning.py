"""Parity for the motion of a clip: what is planned is what is sent, and it is never below none at all."""

import dataclasses
import random

import numpy as np
import pytest

from moving_clips import moving_frames
from splatwire.channel import parse_loss
from splatwire.clips import ClipOptions, encode_clip
from splatwire.clips.damage import SHARES, ClipDamage, pooled
from splatwire.clips.delivery import ClipLoad, delivered, passage
from splatwire.clips.planning import ClipOffer, plan_clip
from splatwire.clips.worth import worth_of, worth_of_stream
from splatwire.errors import InvalidValueError
from splatwire.packets import make_packet
from splatwire.transport import Protection, make_program
from splatwire.transport.collect import PacketCollector
from splatwire.transport.frames import Data, Parity, Welcome
from splatwire.transport.wire import DATA, SIDE

GROUP = 5
RANDOM, BURSTS = parse_loss("bernoulli:0.15", "datagram"), parse_loss("gilbert:0.1,20", "datagram")


@pytest.fixture(scope="module")
def stream():
    return encode_clip(moving_frames(6000, 15), ClipOptions(group_frames=GROUP))[0]


@pytest.fixture(scope="module")
def worth(stream):
    return worth_of_stream(stream)


@pytest.fixture(scope="module")
def load(stream, worth):
    return ClipLoad.of(stream, worth)


def offer_of(load, slope: float = 0.01, base: float = 1e-4) -> ClipOffer:
    """A clip that loses quality in proportion to what is lost of its motion."""
    groups = len(load.groups)
    shares = np.tile([0.0, 1.0], (groups, 1))
    mse = np.tile(np.array([base, base + slope])[None, :, None], (groups, 1, 2))
    return ClipOffer(load, ClipDamage(shares, mse, (GROUP,) * groups))


def test_packets_that_nobody_wrote_are_worth_something_or_nothing(stream):
    """They may name tracks that there are not."""
    plan, rng = stream.manifest.plan, random.Random(3)
    hostile = []
    for packet in stream.packets:
        if not plan.lasting(packet.id.block):
            payloads = (rng.randbytes(rng.randrange(60)) for _ in range(20))
            hostile += [make_packet(packet.id, packet.num_elements, payload) for payload in payloads]
    found = worth_of(stream.manifest, stream.side_info, hostile, np.ones(10))
    assert all(0 <= worth <= 10 for worth in found)


def test_what_moves_and_is_seen_is_dear(stream, worth):
    plan = stream.manifest.plan
    assert {worth[p.id] for p in stream.packets if plan.lasting(p.id.block)} == {0.0}
    assert sum(worth.values()) > 0


@pytest.mark.parametrize("loss", [RANDOM, BURSTS])
def test_what_a_simulation_says_arrives_does_arrive(stream, load, worth, loss):
    protection = Protection(motion=((0.5, 0.6), (1.0, 0.3), (1.0, 0.0)))
    program = make_program(stream, protection, worth=worth)
    items = [item for item in program.schedule if item[0] != SIDE]
    assert items == [tuple(item) for item in passage(load, protection).items.tolist()]
    for seed in range(6):
        fates = loss.received(len(items), np.random.Generator(np.random.PCG64(seed)))
        head = (program.stream_id, program.head_bytes, program.head_digest, program.symbol_bytes)
        welcome = Welcome(1, 1, *head, len(program.packets), program.packet_bytes, 0, program.tiers)
        collector = PacketCollector(welcome)
        collector.open(stream.manifest)
        for (kind, group, number), arrives in zip(items, fates.tolist(), strict=True):
            if arrives and kind == DATA:
                collector.add(Data(1, 0, number, program.packets[number]))
            elif arrives:
                collector.add_parity(Parity(1, 0, group, number, program.parity[group][number]))
        simulated = delivered(load, protection, loss, seed)
        there = {packet.id for packet in collector.packets}
        assert simulated <= there  # a code that is full without a symbol to spare is counted as lost
        assert len(there) - len(simulated) <= max(code.size for code in passage(load, protection).codes)


def test_a_plan_keeps_its_budget_and_is_what_leaves(stream, load, worth):
    plan = plan_clip([offer_of(load)], RANDOM, budget_bytes=1.3 * load.num_bytes)
    assert plan.psnr > plan.unprotected
    assert plan.sent_bytes == load.num_bytes + plan.parity_bytes <= 1.3 * load.num_bytes
    program = make_program(stream, plan.protection, worth=worth)
    symbols = sum(len(group) for group in program.parity)
    assert symbols == passage(load, plan.protection).num_parity > 0
    richer = plan_clip([offer_of(load)], RANDOM, budget_bytes=1.6 * load.num_bytes)
    assert richer.psnr >= plan.psnr
    assert sum(richer.lost) < sum(plan.lost)


def test_where_losses_cost_nothing_nothing_is_protected(load):
    plan = plan_clip([offer_of(load, slope=1e-9)], RANDOM, budget_bytes=2 * load.num_bytes)
    assert plan.parity_bytes == 0
    assert plan.psnr == plan.unprotected


def test_of_two_qualities_the_better_is_chosen_and_never_less(load):
    fine = dataclasses.replace(load, packet_bytes=load.packet_bytes * 5 // 4)
    budget = float(fine.num_bytes)
    for slope in (1e-4, 3e-2):
        coarse_offer, fine_offer = offer_of(load, slope, 1e-4), offer_of(fine, slope, 5e-5)
        plan = plan_clip([coarse_offer, fine_offer], RANDOM, budget_bytes=budget)
        alone = [plan_clip([offer], RANDOM, budget_bytes=budget).psnr for offer in (coarse_offer, fine_offer)]
        assert plan.psnr >= max(alone) - 0.02
        assert plan.offer == (1 if slope < 1e-3 else 0)


def test_a_deadline_is_kept_and_one_that_is_too_short_is_told(load):
    motion = [int(load.packet_bytes[list(group.motion)].sum()) for group in load.groups]
    most = [1.2 * size for size in motion]
    plan = plan_clip([offer_of(load)], RANDOM, budget_bytes=float("inf"), group_bytes=most)
    for group, size in enumerate(motion):
        way = passage(load, Protection(motion=(plan.protection.motion_of(group),)), group)
        assert size + way.num_parity * load.parity_bytes <= 1.2 * size
    with pytest.raises(InvalidValueError, match="too short"):
        plan_clip([offer_of(load)], RANDOM, budget_bytes=float("inf"), group_bytes=[0.9 * size for size in motion])


def test_qualities_share_how_errors_grow_and_a_draw_out_of_the_common_is_not_believed():
    shares, added = np.array([SHARES]), np.array([[0.0, 1.0, 3.0, 6.0, 20.0, 500.0]])[:, :, None] * 1e-5
    true = [ClipDamage(shares, 1e-4 / factor + factor * added, (GROUP,)) for factor in (0.5, 1.0, 2.0)]
    drawn = [dataclasses.replace(damage, mse=damage.mse.copy()) for damage in true]
    drawn[0].mse[0, 3] *= 100
    for found, damage in zip(pooled(drawn), true, strict=True):
        assert np.allclose(found.mse, damage.mse)
    assert np.allclose(pooled(true[:1])[0].mse, true[0].mse)
