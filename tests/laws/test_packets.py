"""Laws of packets for every packetization, stream and loss."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from reference.splitmix64 import splitmix64_reference
from splatwire.bitstream import (
    Packetization,
    PacketPlan,
    SceneStream,
    TierCounts,
    count_tiers,
    make_packet,
    make_stream,
    manifest_from_bytes,
    manifest_to_bytes,
    measure_sizes,
    read_stream,
    stream_from_bytes,
    stream_to_bytes,
    tier_order,
    write_stream,
)
from splatwire.channel import parse_loss, transmit

laws = settings(max_examples=60, deadline=None)
packetizations = st.builds(
    Packetization,
    block_size=st.integers(1, 300),
    lanes=st.integers(1, 20),
    seed=st.integers(0, (1 << 64) - 1),
    order=st.sampled_from(["morton", "raster"]),
    grouping=st.sampled_from(["stratified", "contiguous"]),
    packaging=st.sampled_from(["atomic", "separated"]),
)
sizes, seeds = st.integers(0, 200), st.integers(0, 99)
losses = st.sampled_from(["none", "bernoulli:0", "bernoulli:0.2", "bernoulli:1", "gilbert:0.2,3", "gilbert:20/20"])
cuts = st.lists(st.integers(0, 1500), max_size=3)
plans = st.tuples(packetizations, st.integers(0, 1500), cuts)


def plan_of(packetization: Packetization, num_anchors: int, cuts: list[int] | tuple[()] = ()) -> PacketPlan:
    """A plan with tiers that end at the cuts; created inside the tests because type checks draw from `random`."""
    inner = {cut for cut in cuts if 0 < cut < num_anchors}
    if not inner or packetization.packaging != "atomic":
        return PacketPlan(packetization, num_anchors, num_feature_groups=2 if packetization.separated else 0)
    tiers = np.searchsorted(sorted(inner), np.arange(num_anchors), side="right")
    return PacketPlan(packetization, num_anchors, count_tiers(tiers, packetization))


def build(packetization: Packetization, num_anchors: int, seed: int, tiers: tuple[TierCounts, ...] = ()) -> SceneStream:
    """A stream of random bytes; created inside the tests because type checks draw from `random`."""
    plan, rng = (
        PacketPlan(packetization, num_anchors, tiers, 2 if packetization.separated else 0),
        np.random.default_rng(seed),
    )
    return make_stream(
        packetization=plan.packetization,
        num_elements=plan.num_elements,
        feature_dim=7,
        num_offsets=3,
        feature_groups=(2, 5),
        side_info=rng.bytes(int(rng.integers(30))),
        packets=[make_packet(i, plan.count(i), rng.bytes(int(rng.integers(9)))) for i in plan.ids],
        symbols_digest="ab" * 32,
        writer="law",
        tiers=tiers,
    )


@laws
@given(plans)
def test_each_rank_is_in_exactly_one_group(args):
    plan = plan_of(*args)
    num_parts = len(plan.parts)
    firsts = plan.ids[::num_parts]
    members = [plan.members(packet_id) for packet_id in firsts]
    assert sorted(np.concatenate([np.empty(0, np.int64), *members]).tolist()) == list(range(plan.num_elements))
    ranks, starts = plan.all_members()
    assert len(starts) == len(firsts) + 1
    for g, ours in enumerate(members):
        assert ours.dtype == np.int64
        assert len(ours) == plan.count(firsts[g]) > 0
        assert (np.diff(ours) > 0).all()
        assert ranks[starts[g] : starts[g + 1]].tolist() == ours.tolist()


@laws
@given(plans)
def test_all_representations_of_a_plan_agree(args):
    plan = plan_of(*args)
    p, index = plan.packetization, plan.packet_index_of()
    assert index.dtype == np.int32
    assert list(plan.ids) == sorted(set(plan.ids))
    assert {i.block * p.lanes + i.index_in_block for i in plan.ids} == set(index.tolist())
    for packet_id in plan.ids:
        assert (
            plan.members(packet_id).tolist()
            == np.flatnonzero(index == packet_id.block * p.lanes + packet_id.index_in_block).tolist()
        )


@laws
@given(plans)
def test_a_packet_holds_anchors_of_one_tier(args):
    plan = plan_of(*args)
    bounds = np.cumsum([0, *(tier.num_elements for tier in plan.tiers or ())])
    for packet_id in plan.ids if plan.tiers else ():
        tier = plan.tier_of(packet_id.block)
        members = plan.members(packet_id)
        assert bounds[tier] <= members[0]
        assert members[-1] < bounds[tier + 1]
        assert packet_id.index_in_block < plan.tiers[tier].lanes


@laws
@given(st.lists(st.integers(0, 3), max_size=300), packetizations, losses, seeds)
def test_tiers_round_trip(numbers, packetization, loss, seed):
    """Manifest, bytes and channel with tiers; places are a permutation of ranks that keeps the order of each tier."""
    tiers = np.unique(numbers, return_inverse=True)[1].astype(np.uint8)
    order = tier_order(tiers)
    assert sorted(order.tolist()) == list(range(len(tiers)))
    assert sorted(zip(tiers[order].tolist(), order.tolist(), strict=True)) == list(
        zip(tiers[order].tolist(), order.tolist(), strict=True)
    )
    packetization = replace(packetization, packaging="atomic")
    stream = build(packetization, len(tiers), seed, count_tiers(tiers, packetization) if len(tiers) else ())
    assert stream.manifest.tiers == stream.manifest.plan.tiers
    arrived, _ = transmit(stream, parse_loss(loss), seed=seed)
    again, report = stream_from_bytes(stream_to_bytes(arrived))
    assert again == arrived
    assert report.num_received == len(arrived.packets)
    sizes = measure_sizes(arrived)
    assert sum(tier["num_elements"] for tier in sizes.tiers.values()) == (len(tiers) if sizes.tiers else 0)
    if sizes.tiers:
        assert sum(tier["packet_bytes"] for tier in sizes.tiers.values()) == sum(p.num_bytes for p in arrived.packets)


@laws
@given(plans)
def test_plan_follows_the_papers_equations(args):
    plan = plan_of(*args[:2])
    p = plan.packetization
    for rank, j in enumerate(plan.packet_index_of().tolist()):
        block, lane = divmod(j, p.lanes)
        assert block == rank // p.block_size
        if p.grouping == "stratified":
            assert lane == splitmix64_reference(rank ^ p.seed) % p.lanes


@laws
@given(plans)
def test_contiguous_packets_hold_runs_of_ranks(args):
    plan = plan_of(*args[:2])
    p = plan.packetization
    plan = PacketPlan(Packetization(p.block_size, p.lanes, grouping="contiguous"), plan.num_elements)
    index = plan.packet_index_of()
    assert (np.diff(index) >= 0).all()
    for block in range(plan.num_blocks):
        size = min(p.block_size, plan.num_elements - block * p.block_size)
        counts = np.bincount(index, minlength=plan.num_blocks * p.lanes)[block * p.lanes : (block + 1) * p.lanes]
        assert counts.sum() == size
        assert counts.max() - counts.min() <= 1


@laws
@given(packetizations, sizes)
def test_manifest_round_trips(packetization, num_anchors):
    stream = build(packetization, num_anchors, 0)
    assert manifest_from_bytes(manifest_to_bytes(stream.manifest)) == stream.manifest
    assert stream.manifest.plan.ids == tuple(packet.id for packet in stream.packets)


@laws
@given(packetizations, sizes, losses, seeds)
def test_a_channel_only_removes_packets(packetization, num_anchors, loss, seed):
    stream = build(packetization, num_anchors, seed)
    arrived, record = transmit(stream, parse_loss(loss), seed=seed)
    assert (arrived.manifest, arrived.side_info) == (stream.manifest, stream.side_info)
    assert set(arrived.packets) <= set(stream.packets)
    assert len(arrived.packets) + record.num_lost == len(stream.packets)
    data = stream_to_bytes(arrived)
    assert len(data) == arrived.num_bytes
    again, report = stream_from_bytes(data)
    assert again == arrived
    assert (report.num_missing, report.problems) == (record.num_lost, ())


@pytest.mark.slow
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(packetizations, sizes, losses, seeds)
def test_directory_and_file_hold_equal_streams(tmp_path, packetization, num_anchors, loss, seed):
    """Round trip through directory and file; losing packets by the channel equals deleting their files."""
    stream = build(packetization, num_anchors, seed)
    arrived, record = transmit(stream, parse_loss(loss), seed=seed)
    write_stream(stream, tmp_path / "stream")
    for name in record.lost:
        (tmp_path / "stream" / name).unlink()
    from_directory = read_stream(tmp_path / "stream")
    write_stream(from_directory[0], tmp_path / "stream.swz")
    assert (tmp_path / "stream.swz").read_bytes() == stream_to_bytes(arrived)
    from_file = read_stream(tmp_path / "stream.swz")
    assert from_directory == from_file
    assert from_file[0] == arrived
